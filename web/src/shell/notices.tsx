/** What must not be missed: the banner of a lost link, and the voice of the page. */

import { useSignalEffect } from "@preact/signals";
import { useState } from "preact/hooks";
import { age, clock } from "../format";
import { useNow } from "../parts/age";
import { Icon } from "../parts/icon";
import { announcement } from "../state/phases";
import { heard, job, link, mirror } from "../state/server";
import { texts } from "../texts";

// A restart or a hiccup mends itself before a reader could read about it.
const WORTH_SAYING_MS = 1500;

export function Banner() {
  const state = link.value;
  const lost = state.state === "lost";
  const now = useNow(lost);
  if (!lost || now - state.since < WORTH_SAYING_MS) return null;
  const since = heard.value || state.since;
  return (
    <div class="banner fail" role="alert">
      <Icon name="unlink" />
      <span class="grow">
        <b aria-live="off">{texts.link.banner(age((now - since) / 1000))}</b>{" "}
        {mirror.value ? texts.link.asOf(clock(heard.value)) : texts.link.never}
      </span>
      <span class="code">offline</span>
    </div>
  );
}

/** Speaks the progress in steps of ten per cent, and the end. */
export function Voice() {
  const [said, say] = useState("");
  useSignalEffect(() => say(announcement(job.value)));
  return (
    <p class="visually-hidden" role="status" aria-live="polite">
      {said}
    </p>
  );
}
