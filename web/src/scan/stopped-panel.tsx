import type { Job } from "../api/types";
import { Icon } from "../parts/icon";
import { ProblemNote } from "../parts/message";
import { Panel } from "../parts/panel";
import { texts } from "../texts";
import { Again } from "./again";

/** A job that ended without a result, and why. */
export function StoppedPanel({ job }: { job: Job }) {
  return (
    <Panel title={job.title} id="job" aside={<StateTag job={job} />} footer={<Again job={job} primary />}>
      <div class="body roomy stack-3">
        {job.error ? (
          <>
            <p class="title">{texts.job.failed}</p>
            <ProblemNote problem={job.error} />
          </>
        ) : (
          <>
            <p class="title">{job.state === "cancelled" ? texts.job.cancelled : texts.job.interrupted}</p>
            <p class="soft">{job.state === "cancelled" ? texts.job.cancelledDetail : texts.job.interruptedDetail}</p>
          </>
        )}
      </div>
    </Panel>
  );
}

function StateTag({ job }: { job: Job }) {
  const failed = job.state === "failed";
  return (
    <span class={`tag ${failed ? "fail" : ""}`}>
      <Icon name={failed ? "stop" : "info"} />
      {texts.job.states[job.state]}
    </span>
  );
}
