import { commandJob } from "../api/client";
import type { Job, JobCommand } from "../api/types";
import { number, progress, remaining } from "../format";
import { Button } from "../parts/button";
import { Icon } from "../parts/icon";
import { ProblemNote } from "../parts/message";
import { Panel } from "../parts/panel";
import { Progress } from "../parts/progress";
import { waitingJobs } from "../state/mirror";
import { phaseName, phasesOf, shareDone, type Phase } from "../state/phases";
import { connected, mirror } from "../state/server";
import { named, texts } from "../texts";
import { useAct } from "./act";

/** A job at work: its phases with counts, what is left, and the commands that are possible now. */
export function ProgressPanel({ job }: { job: Job }) {
  const share = shareDone(job);
  return (
    <Panel
      title={job.title}
      id="job"
      aside={<span class="tag selected">{texts.job.states[job.state]}</span>}
      footer={<Commands job={job} />}
    >
      <div class={`body stack-3 ${connected.value ? "" : "stale"}`}>
        <div class="row between baseline">
          {share === null ? (
            <span class="soft">{job.state === "queued" ? texts.job.waitsFor : phaseName(job)}</span>
          ) : (
            <span class="figure">
              {number(Math.floor(share * 100))}
              <small> % · {phaseName(job)}</small>
            </span>
          )}
          {job.eta_s !== null && <b>{texts.job.left(remaining(job.eta_s))}</b>}
        </div>
        {/* Before the first frame is through, movement says that something is going on. */}
        <Progress label={texts.job.progress} share={job.state === "queued" ? 0 : share || null} big />
        <ul class="phases">
          {phasesOf(job).map((phase) => (
            <PhaseRow key={phase.name} phase={phase} job={job} />
          ))}
        </ul>
        <Queue />
      </div>
    </Panel>
  );
}

function PhaseRow({ phase, job }: { phase: Phase; job: Job }) {
  const icon = phase.state === "done" ? "check" : phase.state === "now" ? "play" : "clock";
  const { done, total, unit } = job.progress;
  return (
    <li class={phase.state} aria-current={phase.state === "now" ? "step" : undefined}>
      <Icon name={icon} />
      <span>{named(texts.job.phases, phase.name)}</span>
      <span class="count">{phase.state === "now" && total > 0 ? progress(done, total, unit) : ""}</span>
    </li>
  );
}

function Commands({ job }: { job: Job }) {
  const act = useAct();
  const held = job.state === "paused";
  const command = (name: JobCommand) => ({
    off: connected.value
      ? job.allowed.includes(name)
        ? null
        : texts.job.notAllowed(texts.job[name], texts.job.states[job.state].toLowerCase())
      : texts.link.refused,
    onPress: () => act.run(() => commandJob(job.id, name)),
  });
  return (
    <div class="stack-2">
      {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
      <div class="halves">
        <Button size="big" icon={held ? "play" : "pause"} {...command(held ? "resume" : "pause")}>
          {held ? texts.job.resume : texts.job.pause}
        </Button>
        <Button size="big" icon="cross" busy={job.state === "cancelling"} {...command("cancel")}>
          {texts.job.cancel}
        </Button>
      </div>
      <p class="small soft">{texts.job.cancelKeeps}</p>
    </div>
  );
}

function Queue() {
  const waiting = mirror.value ? waitingJobs(mirror.value) : [];
  const act = useAct();
  if (waiting.length === 0) return null;
  return (
    <div class="stack-1">
      <h3>{texts.job.next}</h3>
      <ul class="rows">
        {waiting.map((job) => (
          <li key={job.id}>
            <Icon name="clock" />
            <span class="cut">{job.title}</span>
            {job.allowed.includes("cancel") && (
              <Button
                icon="cross"
                kind="ghost"
                size="small"
                label={`${texts.job.cancel}: ${job.title}`}
                onPress={() => act.run(() => commandJob(job.id, "cancel"))}
              />
            )}
          </li>
        ))}
      </ul>
      {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
    </div>
  );
}
