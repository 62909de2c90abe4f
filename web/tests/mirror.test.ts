import { describe, expect, it } from "vitest";
import { changed, currentJob, ended, waitingJobs, type Change } from "../src/state/mirror";
import { job, mirror } from "./samples";

const put = (seq: number, item: ReturnType<typeof job>): Change => ({
  seq,
  topic: "job",
  action: "put",
  id: item.id,
  item,
});

describe("changed", () => {
  it("puts a new item in front and an old one in its place", () => {
    const before = mirror({ jobs: [job("b", "done"), job("a", "done")] });
    const grown = changed(before, put(2, job("c", "queued")));
    expect(grown.jobs.map((item) => item.id)).toEqual(["c", "b", "a"]);
    const renewed = changed(grown, put(3, job("b", "failed")));
    expect(renewed.jobs.map((item) => item.state)).toEqual(["queued", "failed", "done"]);
    expect(renewed.seq).toBe(3);
  });

  it("takes a deleted item out", () => {
    const before = mirror({ jobs: [job("a", "done")] });
    expect(changed(before, { seq: 2, topic: "job", action: "delete", id: "a", item: null }).jobs).toEqual([]);
  });

  it("ignores a change that the snapshot already holds", () => {
    const before = mirror({ seq: 5, jobs: [job("a", "done")] });
    expect(changed(before, put(5, job("a", "running")))).toBe(before);
  });

  it("passes over topics it does not know", () => {
    const before = mirror();
    expect(changed(before, { seq: 2, topic: "rig", action: "put", id: "r", item: {} } as unknown as Change)).toBe(
      before,
    );
  });

  it("leaves the mirror it was given as it was", () => {
    const before = mirror({ jobs: [job("a", "running")] });
    changed(before, put(2, job("a", "done")));
    expect(before.jobs[0]?.state).toBe("running");
  });
});

describe("the job the page is about", () => {
  it("is the one at work, whatever came later", () => {
    const jobs = [job("d", "queued"), job("c", "done"), job("b", "paused"), job("a", "done")];
    expect(currentJob(mirror({ jobs }))?.id).toBe("b");
  });

  it("is the first in the queue when none works, then the newest", () => {
    expect(currentJob(mirror({ jobs: [job("c", "queued"), job("b", "queued"), job("a", "done")] }))?.id).toBe("b");
    expect(currentJob(mirror({ jobs: [job("b", "failed"), job("a", "done")] }))?.id).toBe("b");
    expect(currentJob(mirror())).toBeNull();
  });

  it("is followed by those that wait, next first", () => {
    const jobs = [job("d", "queued"), job("c", "queued"), job("b", "running"), job("a", "done")];
    expect(waitingJobs(mirror({ jobs })).map((item) => item.id)).toEqual(["c", "d"]);
  });

  it.each(["done", "failed", "cancelled", "interrupted"] as const)("has ended when it is %s", (state) => {
    expect(ended(job("a", state))).toBe(true);
  });

  it.each(["queued", "running", "paused", "cancelling"] as const)("has not ended when it is %s", (state) => {
    expect(ended(job("a", state))).toBe(false);
  });
});
