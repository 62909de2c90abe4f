/** The panel that turns from an invitation into progress and then into results, in one place. */

import { useEffect, useRef } from "preact/hooks";
import type { Job, Scan } from "../api/types";
import { useElapsed } from "../parts/age";
import { Skeleton } from "../parts/message";
import { Panel } from "../parts/panel";
import { ended } from "../state/mirror";
import { job, mirror } from "../state/server";
import { texts } from "../texts";
import { DemoPanel } from "./demo-panel";
import { ProgressPanel } from "./progress-panel";
import { ResultPanel } from "./result-panel";
import { StoppedPanel } from "./stopped-panel";

export function JobPanel() {
  const known = mirror.value !== null;
  const current = job.value;
  useKeptFocus(known ? (current === null ? "none" : `${current.id} ${ended(current)}`) : null);
  return <Content />;
}

// The button that had the focus goes away with its panel; a keyboard must not be thrown back to the top of the page.
function useKeptFocus(stage: string | null): void {
  const before = useRef<string | null>(null);
  useEffect(() => {
    const turned = before.current !== null && before.current !== stage;
    before.current = stage;
    if (turned && document.activeElement === document.body) {
      document.getElementById("job")?.focus({ preventScroll: true });
    }
  }, [stage]);
}

function Content() {
  const known = mirror.value;
  if (known === null) return <LoadingPanel />;
  const current = job.value;
  if (current && !ended(current)) return <ProgressPanel job={current} />;
  if (current && current.state !== "done") return <StoppedPanel job={current} />;
  const scan = resultOf(current, known.scans);
  return scan ? <ResultPanel scan={scan} job={current} /> : <DemoPanel />;
}

function LoadingPanel() {
  const slow = useElapsed(5000);
  return (
    <Panel title={texts.scan} id="job">
      <Skeleton slow={slow} />
    </Panel>
  );
}

/** The scan a job made; the newest scan where no job is known, as after a restart. */
function resultOf(current: Job | null, scans: readonly Scan[]): Scan | null {
  if (current === null) return scans[0] ?? null;
  return scans.find((scan) => scan.id === current.outcome?.scan_id) ?? null;
}
