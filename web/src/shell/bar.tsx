/** The bar that never leaves the screen: whose page it is, what runs, whether the server answers. */

import { Icon } from "../parts/icon";
import { Progress } from "../parts/progress";
import { Segmented } from "../parts/segmented";
import { useNow } from "../parts/age";
import { age, number, percent, remaining } from "../format";
import { ended } from "../state/mirror";
import { phaseName, shareDone } from "../state/phases";
import { heard, job, link, mirror } from "../state/server";
import { theme, THEMES } from "../theme";
import { texts } from "../texts";

export function Bar() {
  return (
    <header class="bar">
      <Brand />
      <JobChip />
      <LinkChip />
      <div class="theme">
        <Segmented
          label={texts.theme.label}
          value={theme.value}
          onChoose={(chosen) => {
            theme.value = chosen;
          }}
          choices={THEMES.map((value) => ({
            value,
            title: texts.theme[value],
            text: (
              <>
                <Icon name={value} />
                <span class="visually-hidden">{texts.theme[value]}</span>
              </>
            ),
          }))}
        />
      </div>
    </header>
  );
}

function Brand() {
  return (
    <div class="brand">
      <svg viewBox="0 0 24 24" aria-hidden="true">
        <rect x="1" y="1" width="22" height="22" rx="6" fill="var(--accent-fill)" />
        <path d="M5 15h5l2-6 2 6h5M5 9h3M16 9h3" stroke="#fff" />
      </svg>
      <h1>{texts.name}</h1>
      {mirror.value?.system.simulated && (
        <span class="tag sim" title={texts.machine.simulatedWhy}>
          {texts.machine.simulated}
        </span>
      )}
    </div>
  );
}

function JobChip() {
  const current = job.value;
  const last = mirror.value?.scans[0];
  if (current === null || ended(current)) {
    return (
      <div class="job-chip">
        <div class="row small">
          <b>{current && current.state !== "done" ? texts.job.states[current.state] : texts.job.ready}</b>
          <span class="soft cut">
            {current && current.state !== "done"
              ? current.title
              : last
                ? texts.job.last(last.name, number(last.points))
                : texts.job.nothing}
          </span>
        </div>
      </div>
    );
  }
  const share = shareDone(current);
  return (
    <div class="job-chip">
      <div class="row small">
        <b>{current.state === "running" ? phaseName(current) : texts.job.states[current.state]}</b>
        <span class="soft cut">{current.title}</span>
      </div>
      <div class="row small">
        {share !== null && <span class="soft">{percent(share)}</span>}
        {current.eta_s !== null && <b>{texts.job.left(remaining(current.eta_s))}</b>}
      </div>
      <Progress label={current.title} share={share || null} />
    </div>
  );
}

function LinkChip() {
  const now = useNow(link.value.state === "lost");
  const state = link.value;
  const lost = state.state === "lost";
  const value =
    state.state === "lost"
      ? texts.link.lost(age(Math.max(0, (now - (heard.value || state.since)) / 1000)))
      : state.state === "live"
        ? texts.link.live
        : texts.link.connecting;
  return (
    <div class={`chip ${lost ? "is-fail" : state.state === "live" ? "is-ok" : ""}`} id="link">
      <Icon name={lost ? "unlink" : "link"} />
      <span>
        <span class="key">{texts.link.label}</span>
        <span class="value">{value}</span>
      </span>
    </div>
  );
}
