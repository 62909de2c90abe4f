/** Calls of the REST interface. Each returns the answer's body or throws a `ServerProblem`. */

import createClient from "openapi-fetch";
import { noAnswer, problemFrom } from "./problem";
import type { paths } from "./schema";
import type { Capture, ColourMode, Job, JobCommand, JobRequest, View } from "./types";

const ROOT = "/api/v1";
const client = createClient<paths>({ baseUrl: location.origin });

interface Answer<T> {
  data?: T;
  error?: unknown;
  response: Response;
}

async function body<T>(call: Promise<Answer<T>>): Promise<T> {
  let answer: Answer<T>;
  try {
    answer = await call;
  } catch {
    throw noAnswer();
  }
  if (answer.data === undefined) throw problemFrom(answer.error, answer.response.status);
  return answer.data;
}

export function startJob(request: JobRequest): Promise<Job> {
  return body<Job>(client.POST("/api/v1/jobs", { body: request }));
}

export function commandJob(id: string, command: JobCommand): Promise<Job> {
  return body<Job>(
    client.POST("/api/v1/jobs/{job_id}/commands", { params: { path: { job_id: id } }, body: { command } }),
  );
}

export function showScan(scan_id: string): Promise<View> {
  return body<View>(client.PUT("/api/v1/view", { body: { scan_id } }));
}

export function colourView(colour: ColourMode): Promise<View> {
  return body<View>(client.PUT("/api/v1/view", { body: { colour } }));
}

/** Use a folder on the server's machine as a capture. */
export function openFolder(path: string): Promise<Capture> {
  return send("POST", `${ROOT}/captures`, JSON.stringify({ path }), "application/json");
}

/** Send a zipped capture folder; `sent` is told the share of bytes that have left, from 0 to 1. */
export function uploadCapture(file: File, sent: (share: number) => void): Promise<Capture> {
  return send("POST", `${ROOT}/captures?name=${encodeURIComponent(file.name)}`, file, "application/zip", sent);
}

/** Keep a rig file beside a capture. */
export function uploadRig(captureId: string, file: File): Promise<Capture> {
  return send("PUT", `${ROOT}/captures/${encodeURIComponent(captureId)}/rig`, file, "application/json");
}

// XMLHttpRequest, because fetch cannot tell how much of a body has been sent.
function send<T>(
  method: string,
  url: string,
  content: XMLHttpRequestBodyInit,
  type: string,
  sent?: (share: number) => void,
): Promise<T> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open(method, url);
    request.setRequestHeader("Content-Type", type);
    request.responseType = "text";
    if (sent) {
      request.upload.onprogress = (event) => {
        if (event.lengthComputable) sent(event.loaded / event.total);
      };
    }
    request.onerror = () => reject(noAnswer());
    request.onload = () => {
      const answer = parsed(request.responseText);
      if (request.status >= 200 && request.status < 300) resolve(answer as T);
      else reject(problemFrom(answer, request.status));
    };
    request.send(content);
  });
}

function parsed(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}
