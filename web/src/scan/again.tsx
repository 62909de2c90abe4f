/** The ways on from a job that has ended. */

import { startJob } from "../api/client";
import type { Job, JobRequest } from "../api/types";
import { Button } from "../parts/button";
import { ProblemNote } from "../parts/message";
import { connected } from "../state/server";
import { texts } from "../texts";
import { useAct } from "./act";

export function Again({ job, primary }: { job: Job | null; primary?: boolean }) {
  const act = useAct();
  const off = connected.value ? null : texts.link.refused;
  const start = (request: JobRequest) => () => act.run(() => startJob(request));
  return (
    <div class="stack-2">
      {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
      <div class="row wrap">
        {job && (
          <Button
            kind={primary ? "primary" : "plain"}
            icon="retry"
            busy={act.busy}
            off={off}
            onPress={start(job.request as JobRequest)}
          >
            {primary ? texts.job.retry : texts.job.again}
          </Button>
        )}
        {job?.kind !== "demo" && (
          <Button icon="play" busy={act.busy} off={off} onPress={start({ kind: "demo" })}>
            {texts.demo.run}
          </Button>
        )}
      </div>
    </div>
  );
}
