/** Items as the server sends them, with only what a test is about to be said. */

import type { Capture, Job, Scan, System, View } from "../src/api/types";
import type { Mirror } from "../src/state/mirror";

export function job(id: string, state: Job["state"], more: Partial<Job> = {}): Job {
  return {
    id,
    kind: "demo",
    title: `Job ${id}`,
    state,
    progress: { phase: null, done: 0, total: 0, unit: "frames" },
    created_at: "2026-11-22T04:59:03.120Z",
    started_at: null,
    ended_at: null,
    eta_s: null,
    request: { kind: "demo" },
    outcome: null,
    error: null,
    allowed: [],
    ...more,
  };
}

export const system: System = {
  name: "Twinline",
  version: "0.1.0",
  started_at: "2026-11-22T04:58:00Z",
  simulated: true,
  workers: 2,
  methods: ["maximum-likelihood", "steger"],
  default_method: "maximum-likelihood",
  sources: ["laser1", "laser2"],
  scenes: [{ name: "relief", title: "Relief" }],
  limits: { upload_bytes: 1_000_000 },
  data_dir: "/data",
};

const view: View = {
  page: "/view/",
  colour: "height",
  colours: ["height", "source"],
  points: 0,
  shown: 0,
  scan_id: null,
  job_id: null,
  legend: null,
  note: null,
};

export function mirror(
  parts: { seq?: number; jobs?: Job[]; captures?: Capture[]; scans?: Scan[]; view?: View } = {},
): Mirror {
  return { seq: 1, system, jobs: [], captures: [], scans: [], view, ...parts };
}
