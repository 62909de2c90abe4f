/** The server's nouns under short names; `schema.ts` is generated from server/openapi.json. */

import type { components } from "./schema";

type Schemas = components["schemas"];

export type System = Schemas["SystemOut"];
export type Capture = Schemas["CaptureOut"];
export type Job = Schemas["JobOut"];
export type JobRequest = Schemas["ReconstructIn"] | Schemas["DemoIn"];
export type Scan = Schemas["ScanOut"];
export type View = Schemas["ViewOut"];
export type ColourMode = View["colour"];
export type Snapshot = Schemas["SnapshotOut"];
export type JobState = Job["state"];
export type JobCommand = Schemas["CommandIn"]["command"];
