/**
 * Server-sent events over fetch. Unlike EventSource this sees the comment lines that keep the stream alive, so that a
 * link that went silent (a laptop that slept, a pulled cable) is noticed.
 */

export interface StreamEvent {
  event: string;
  data: string;
}

/** Cuts a stream of text, split anywhere, into events. */
export class EventParser {
  #rest = "";
  #event = "";
  #data: string[] = [];

  /** The events that `text` completes. */
  push(text: string): StreamEvent[] {
    const events: StreamEvent[] = [];
    const lines = (this.#rest + text).split(/\r\n|\n|\r(?!$)/);
    this.#rest = lines.pop() ?? "";
    for (const line of lines) {
      const event = this.#line(line);
      if (event) events.push(event);
    }
    return events;
  }

  #line(line: string): StreamEvent | null {
    if (line === "") {
      const complete = this.#data.length > 0 ? { event: this.#event || "message", data: this.#data.join("\n") } : null;
      this.#event = "";
      this.#data = [];
      return complete;
    }
    const colon = line.indexOf(":");
    const field = colon < 0 ? line : line.slice(0, colon);
    const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
    if (field === "event") this.#event = value;
    else if (field === "data") this.#data.push(value);
    return null;
  }
}

/**
 * Read one stream until it ends; rejects when it cannot be opened, breaks, or says nothing for `silence_ms`.
 */
export async function readEvents(
  url: string,
  onEvent: (event: StreamEvent) => void,
  options: { silence_ms: number; signal: AbortSignal },
): Promise<void> {
  const silent = new AbortController();
  let timer = setTimeout(() => silent.abort(), options.silence_ms);
  try {
    const response = await fetch(url, {
      headers: { Accept: "text/event-stream" },
      cache: "no-store",
      signal: AbortSignal.any([silent.signal, options.signal]),
    });
    if (!response.ok || !response.body) throw new Error(`events answered ${response.status}`);
    const parser = new EventParser();
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      clearTimeout(timer);
      timer = setTimeout(() => silent.abort(), options.silence_ms);
      for (const event of parser.push(value)) onEvent(event);
    }
  } finally {
    clearTimeout(timer);
  }
}
