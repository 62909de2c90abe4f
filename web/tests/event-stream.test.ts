import { describe, expect, it } from "vitest";
import { EventParser, type StreamEvent } from "../src/api/event-stream";

const STREAM =
  ': hello\n\nevent: snapshot\nid: 41\ndata: {"seq": 41}\n\n: still here\n\nevent: change\ndata: {"a":\ndata: 1}\n\ndata: bare\n\n';
const EVENTS: StreamEvent[] = [
  { event: "snapshot", data: '{"seq": 41}' },
  { event: "change", data: '{"a":\n1}' },
  { event: "message", data: "bare" },
];

describe("EventParser", () => {
  it("gives the events of a stream and passes over comments", () => {
    expect(new EventParser().push(STREAM)).toEqual(EVENTS);
  });

  it.each(["\n", "\r\n", "\r"])("gives the same wherever the stream is cut, with lines that end in %j", (end) => {
    const text = STREAM.replaceAll("\n", end) + (end === "\r" ? ":" : "");
    for (let cut = 0; cut <= text.length; cut += 1) {
      const parser = new EventParser();
      expect([...parser.push(text.slice(0, cut)), ...parser.push(text.slice(cut))]).toEqual(EVENTS);
    }
  });

  it("keeps an unfinished event back", () => {
    const parser = new EventParser();
    expect(parser.push("event: change\ndata: 1\n")).toEqual([]);
    expect(parser.push("\n")).toEqual([{ event: "change", data: "1" }]);
  });
});
