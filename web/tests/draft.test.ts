import { describe, expect, it } from "vitest";
import { EMPTY_DRAFT, everyOf, missing, requestOf, sourcesOf, type Draft } from "../src/scan/draft";
import { texts } from "../src/texts";
import { system } from "./samples";

const ready: Draft = { ...EMPTY_DRAFT, path: "/captures/bust" };
const file = (name: string) => new File(["x"], name);

describe("missing", () => {
  it.each<[string, Partial<Draft>]>([
    [texts.own.needs.path, { path: "  " }],
    [texts.own.needs.zip, { origin: "zip" }],
    [texts.own.needs.known, { origin: "known" }],
    [texts.own.needs.sources, { sources: [] }],
    [texts.own.needs.every, { every: "0" }],
    [texts.own.needs.rig, { rig: "file" }],
  ])("%s", (reason, part) => expect(missing({ ...ready, ...part }, system)).toBe(reason));

  it.each<Partial<Draft>>([
    {},
    { origin: "zip", zip: file("a.zip") },
    { origin: "known", knownId: "c-1" },
    { rig: "file", rigFile: file("rig.json") },
  ])("nothing is, with %j", (part) => expect(missing({ ...ready, ...part }, system)).toBeNull());
});

describe("everyOf", () => {
  it.each(["", "0", "-1", "1.5", "2x", "1e3", "10000000"])("refuses %j", (every) =>
    expect(everyOf({ ...ready, every })).toBeNull(),
  );
  it("takes whole numbers", () => expect(everyOf({ ...ready, every: " 12 " })).toBe(12));
});

describe("requestOf", () => {
  it("asks for the server's defaults where nothing was chosen", () => {
    expect(requestOf(ready, system, { id: "c-1" })).toEqual({
      kind: "reconstruct",
      capture_id: "c-1",
      rig: "auto",
      method: "maximum-likelihood",
      sources: ["laser1", "laser2"],
      every: 1,
    });
  });

  it("asks for what was chosen, lasers in the server's order", () => {
    const draft: Draft = { ...ready, method: "steger", sources: ["laser2", "laser1"], every: "3", rig: "nominal" };
    expect(sourcesOf(draft, system)).toEqual(["laser1", "laser2"]);
    expect(requestOf(draft, system, { id: "c-1" })).toMatchObject({ method: "steger", every: 3, rig: "nominal" });
  });
});
