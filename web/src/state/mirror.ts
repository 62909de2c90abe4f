/** The page's copy of what the server knows: a snapshot, then changes. Pure; `server.ts` feeds it. */

import type { Capture, Job, Scan, Snapshot, View } from "../api/types";

/** Lists are newest first. */
export type Mirror = {
  readonly [Part in keyof Snapshot]: Snapshot[Part] extends (infer Item)[] ? readonly Item[] : Snapshot[Part];
};

interface ChangeOf<Topic extends string, Item> {
  readonly seq: number;
  readonly topic: Topic;
  readonly action: "put" | "delete";
  readonly id: string;
  readonly item: Item | null;
}

export type Change =
  ChangeOf<"job", Job> | ChangeOf<"capture", Capture> | ChangeOf<"scan", Scan> | ChangeOf<"view", View>;

/** `list` with `item` in the place of its older self, or in front when it is new; without it when it is null. */
function replaced<Item extends { id: string }>(list: readonly Item[], id: string, item: Item | null): readonly Item[] {
  if (item === null) return list.filter((other) => other.id !== id);
  return list.some((other) => other.id === id)
    ? list.map((other) => (other.id === id ? item : other))
    : [item, ...list];
}

/** The mirror after one change; a change the mirror already holds leaves it as it is. */
export function changed(mirror: Mirror, change: Change): Mirror {
  if (change.seq <= mirror.seq) return mirror;
  const { seq, id } = change;
  switch (change.topic) {
    case "job":
      return { ...mirror, seq, jobs: replaced(mirror.jobs, id, change.item) };
    case "capture":
      return { ...mirror, seq, captures: replaced(mirror.captures, id, change.item) };
    case "scan":
      return { ...mirror, seq, scans: replaced(mirror.scans, id, change.item) };
    case "view":
      return { ...mirror, seq, view: change.item ?? mirror.view };
    default:
      // A newer server may have topics this page does not know.
      return mirror;
  }
}

const AT_WORK: ReadonlySet<Job["state"]> = new Set(["running", "paused", "cancelling"]);

/** Whether a job has come to its end, one way or another. */
export function ended(job: Job): boolean {
  return !AT_WORK.has(job.state) && job.state !== "queued";
}

/** The job the page is about: the one at work, else the next in the queue, else the newest. */
export function currentJob(mirror: Mirror): Job | null {
  const newestFirst = mirror.jobs;
  return (
    newestFirst.find((job) => AT_WORK.has(job.state)) ??
    newestFirst.findLast((job) => job.state === "queued") ??
    newestFirst[0] ??
    null
  );
}

/** Jobs that wait behind the current one, next first. */
export function waitingJobs(mirror: Mirror): readonly Job[] {
  const current = currentJob(mirror);
  return mirror.jobs.filter((job) => job.state === "queued" && job.id !== current?.id).toReversed();
}
