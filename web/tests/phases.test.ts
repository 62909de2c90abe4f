import { describe, expect, it } from "vitest";
import { announcement, phasesOf, shareDone } from "../src/state/phases";
import { job } from "./samples";

const at = (phase: string, done = 0, total = 0) => ({ phase, done, total, unit: "frames" });

describe("phasesOf", () => {
  it("parts the phases of a demo into done, now and to do", () => {
    const states = phasesOf(job("a", "running", { progress: at("Reconstructing") })).map((phase) => phase.state);
    expect(states).toEqual(["done", "done", "now", "todo"]);
  });

  it("marks all as done at the end", () => {
    const phases = phasesOf(job("a", "done", { kind: "reconstruct", progress: at("Writing") }));
    expect(phases.map((phase) => phase.state)).toEqual(["done", "done", "done"]);
  });

  it("shows a phase it does not know", () => {
    const phases = phasesOf(job("a", "running", { kind: "reconstruct", progress: at("Meshing") }));
    expect(phases.at(-1)).toEqual({ name: "Meshing", state: "now" });
  });
});

describe("shareDone", () => {
  it("is not known while the total is 0", () => expect(shareDone(job("a", "running"))).toBeNull());
  it("never exceeds the whole", () => {
    expect(shareDone(job("a", "running", { progress: at("Writing", 3, 2) }))).toBe(1);
  });
});

describe("announcement", () => {
  it("speaks in steps of ten per cent", () => {
    const said = [239, 240, 287].map((done) =>
      announcement(job("a", "running", { progress: at("Reconstructing", done, 400) })),
    );
    expect(said[0]).toContain("50");
    expect(said[1]).toContain("60");
    expect(said[2]).toContain("70");
    expect(announcement(job("a", "running", { progress: at("Reconstructing", 250, 400) }))).toBe(said[1]);
  });

  it("tells how a job ended", () => {
    expect(announcement(job("a", "failed"))).toBe("Job a failed.");
    expect(announcement(job("a", "done"))).toBe("Job a finished.");
  });

  it("is silent before anything runs", () => {
    expect(announcement(null)).toBe("");
    expect(announcement(job("a", "queued"))).toBe("");
  });
});
