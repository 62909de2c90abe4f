/** The link to the server: one stream of events that reconnects by itself, mirrored into signals. */

import { computed, signal } from "@preact/signals";
import { readEvents, type StreamEvent } from "../api/event-stream";
import { changed, currentJob, type Change, type Mirror } from "./mirror";

export type Link =
  | { readonly state: "connecting" }
  | { readonly state: "live" }
  | { readonly state: "lost"; readonly since: number; readonly attempt: number };

/** What the server last said; null until it first said anything. */
export const mirror = signal<Mirror | null>(null);
export const link = signal<Link>({ state: "connecting" });
/** The time of the last message, in milliseconds since the epoch. */
export const heard = signal(0);
/** Whether commands can be given: they are refused while the link is down, never queued. */
export const connected = computed(() => link.value.state === "live");
export const job = computed(() => (mirror.value ? currentJob(mirror.value) : null));

const EVENTS = "/api/v1/events";
// The server writes at least every 10 s.
const SILENCE_MS = 25_000;
const RETRY_MS = [300, 1000, 2000, 4000] as const;

/** Take in one message of the stream. */
export function receive(message: StreamEvent): void {
  heard.value = Date.now();
  if (message.event === "snapshot") {
    mirror.value = JSON.parse(message.data) as Mirror;
    link.value = { state: "live" };
  } else if (message.event === "change" && mirror.peek()) {
    mirror.value = changed(mirror.peek() as Mirror, JSON.parse(message.data) as Change);
  }
}

function lose(): void {
  const before = link.peek();
  link.value =
    before.state === "lost"
      ? { ...before, attempt: before.attempt + 1 }
      : { state: "lost", since: Date.now(), attempt: 1 };
}

function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, milliseconds);
    // Back from sleep or back on the network: there is no reason to wait longer.
    window.addEventListener("online", () => (clearTimeout(timer), resolve()), { once: true, signal });
  });
}

/** Follow the server until `signal` is aborted. */
export async function follow(signal: AbortSignal): Promise<void> {
  while (!signal.aborted) {
    try {
      await readEvents(EVENTS, receive, { silence_ms: SILENCE_MS, signal });
    } catch {
      // Every reason ends the same way: say so, wait, try again.
    }
    lose();
    const { attempt } = link.peek() as Extract<Link, { state: "lost" }>;
    await pause(RETRY_MS[Math.min(attempt, RETRY_MS.length) - 1] ?? 4000, signal);
  }
}
