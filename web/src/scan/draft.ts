/** What the reader has filled in for an own capture, and what is still missing. Pure. */

import type { Capture, JobRequest, System } from "../api/types";
import { texts } from "../texts";

export type Origin = "folder" | "zip" | "known";
export type RigChoice = "auto" | "nominal" | "file";

export interface Draft {
  readonly origin: Origin;
  readonly path: string;
  readonly zip: File | null;
  readonly knownId: string | null;
  readonly method: string | null;
  readonly sources: readonly string[] | null;
  readonly every: string;
  readonly rig: RigChoice;
  readonly rigFile: File | null;
}

export const EMPTY_DRAFT: Draft = {
  origin: "folder",
  path: "",
  zip: null,
  knownId: null,
  method: null,
  sources: null,
  every: "1",
  rig: "auto",
  rigFile: null,
};

/** The extraction method in force: chosen, else the server's default. */
export function methodOf(draft: Draft, system: System): string {
  return draft.method ?? system.default_method;
}

/** The lasers in force, in the server's order. */
export function sourcesOf(draft: Draft, system: System): string[] {
  const chosen = draft.sources ?? system.sources;
  return system.sources.filter((source) => chosen.includes(source));
}

/** The step between frames, or null where it is no whole number of 1 or more. */
export function everyOf(draft: Draft): number | null {
  return /^[1-9]\d{0,5}$/.test(draft.every.trim()) ? Number(draft.every) : null;
}

/** Why the work cannot start yet, or null when it can. */
export function missing(draft: Draft, system: System): string | null {
  if (draft.origin === "folder" && draft.path.trim() === "") return texts.own.needs.path;
  if (draft.origin === "zip" && draft.zip === null) return texts.own.needs.zip;
  if (draft.origin === "known" && draft.knownId === null) return texts.own.needs.known;
  if (sourcesOf(draft, system).length === 0) return texts.own.needs.sources;
  if (everyOf(draft) === null) return texts.own.needs.every;
  if (draft.rig === "file" && draft.rigFile === null) return texts.own.needs.rig;
  return null;
}

/** The job that the draft asks for, on a capture the server already has. */
export function requestOf(draft: Draft, system: System, capture: Pick<Capture, "id">): JobRequest {
  return {
    kind: "reconstruct",
    capture_id: capture.id,
    rig: draft.rig === "nominal" ? "nominal" : "auto",
    method: methodOf(draft, system),
    sources: sourcesOf(draft, system),
    every: everyOf(draft) ?? 1,
  } as JobRequest;
}
