/** The phases of a job as a reader follows them. */

import type { Job } from "../api/types";
import { percent } from "../format";
import { named, texts } from "../texts";
import { ended } from "./mirror";

const PHASES: Readonly<Record<Job["kind"], readonly string[]>> = {
  demo: ["Rendering", "Opening", "Reconstructing", "Writing"],
  reconstruct: ["Opening", "Reconstructing", "Writing"],
};

export interface Phase {
  readonly name: string;
  readonly state: "done" | "now" | "todo";
}

/** All phases of a job's kind with their states; a phase this page does not know stands last. */
export function phasesOf(job: Job): readonly Phase[] {
  const known = PHASES[job.kind];
  const now = job.progress.phase;
  const names = now === null || known.includes(now) ? known : [...known, now];
  const at = now === null ? -1 : names.indexOf(now);
  return names.map((name, index) => ({
    name,
    state: job.state === "done" || index < at ? "done" : index === at ? "now" : "todo",
  }));
}

/** The share of the present phase, from 0 to 1; null while its size is not known. */
export function shareDone(job: Job): number | null {
  const { done, total } = job.progress;
  return total > 0 ? Math.min(1, done / total) : null;
}

/** The name of the present phase in the page's language. */
export function phaseName(job: Job): string {
  return job.progress.phase === null ? texts.job.starting : named(texts.job.phases, job.progress.phase);
}

/** What a screen reader is told about a job: each ten per cent of a phase, and how it ended. */
export function announcement(job: Job | null): string {
  if (job === null || job.state === "queued") return "";
  if (ended(job)) {
    const how = texts.job.ended[job.state as keyof typeof texts.job.ended];
    return texts.job.endedAnnounced(job.title, how);
  }
  if (job.state !== "running") return `${job.title}: ${texts.job.states[job.state]}`;
  const share = Math.floor((shareDone(job) ?? 0) * 10) / 10;
  return texts.job.phaseAnnounced(job.title, phaseName(job), percent(share));
}
