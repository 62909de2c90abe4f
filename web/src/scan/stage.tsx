/** The live 3-D view: the server's own viewer in a frame, what colours mean, and how many points are shown. */

import { useEffect, useRef, useState } from "preact/hooks";
import { colourView } from "../api/client";
import type { ColourMode, View } from "../api/types";
import { number } from "../format";
import { Button } from "../parts/button";
import { ProblemNote, State } from "../parts/message";
import { Panel } from "../parts/panel";
import { Segmented } from "../parts/segmented";
import { ended, type Mirror } from "../state/mirror";
import { connected, job, mirror } from "../state/server";
import { texts } from "../texts";
import { useAct } from "./act";
import { Legend } from "./legend";
import { Sketch } from "./sketch";

export function Stage() {
  const known = mirror.value;
  const act = useAct();
  const stage = useRef<HTMLDivElement>(null);
  const choose = (colour: ColourMode) => act.run(() => colourView(colour));
  useColourKeys(known?.view.colours ?? [], choose);
  return (
    <Panel
      title={texts.stage.title}
      id="stage"
      class="stage-panel"
      sub={known && known.view.points > 0 && <Shown known={known} />}
      aside={
        <>
          {known && (
            <Segmented
              label={texts.stage.colourBy}
              value={known.view.colour}
              off={!connected.value}
              onChoose={choose}
              choices={known.view.colours.map((value, index) => ({
                value,
                text: texts.stage.colours[value],
                title: texts.stage.key(texts.stage.colourHints[value], String(index + 1)),
              }))}
            />
          )}
          <Button
            icon="expand"
            kind="ghost"
            label={texts.stage.full}
            onPress={() => void stage.current?.requestFullscreen()}
          />
        </>
      }
    >
      {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
      <div class={`stage ${connected.value ? "" : "stale"}`} ref={stage}>
        {known === null ? <StageWaiting /> : <Picture known={known} />}
      </div>
    </Panel>
  );
}

function StageWaiting() {
  return <State icon="cube" title={texts.loading.waiting} />;
}

/** The viewer, once there has been something to see; it stays, so that the reader's point of view stays. */
function Picture({ known }: { known: Mirror }) {
  const { view, system } = known;
  const anything = view.points > 0 || view.job_id !== null || view.scan_id !== null;
  const working = job.value !== null && !ended(job.value);
  const [opened, setOpened] = useState(anything);
  useEffect(() => {
    if (anything) setOpened(true);
  }, [anything]);
  return (
    <>
      {(opened || anything) && (
        // A restarted server has a new viewer: its page is loaded anew.
        <iframe key={system.started_at} src={view.page} title={texts.stage.label} allow="fullscreen" />
      )}
      {view.points === 0 && (
        <div class="veil">
          <State picture={<Sketch />} title={working ? texts.stage.waiting : texts.stage.empty}>
            <p class="small">{texts.stage.emptyHint}</p>
          </State>
        </div>
      )}
      {view.points > 0 && <Hud view={view} />}
    </>
  );
}

/** Whose points these are. */
function Shown({ known }: { known: Mirror }) {
  const { view } = known;
  const scan = known.scans.find((item) => item.id === view.scan_id);
  const running = known.jobs.find((item) => item.id === view.job_id);
  return (
    <>
      <span class="sub cut">{scan?.name ?? running?.title}</span>
      {isSimulated(known, view) && <span class="tag sim">{texts.machine.simulatedMark}</span>}
    </>
  );
}

function Hud({ view }: { view: View }) {
  return (
    <>
      <div class="hud bottom-left" id="stage-points">
        <span>
          {view.shown < view.points
            ? texts.stage.someShown(number(view.shown), number(view.points))
            : texts.stage.points(number(view.points))}
        </span>
        {view.note && <span class="faint">{view.note}</span>}
      </div>
      <div class="hud bottom-right">
        <Legend view={view} />
      </div>
    </>
  );
}

/** Whether the shown points come from the simulator; such a picture always carries its mark. */
function isSimulated({ jobs, scans, captures }: Mirror, view: View): boolean {
  if (view.job_id !== null) return jobs.some((job) => job.id === view.job_id && job.kind === "demo");
  const scan = scans.find((item) => item.id === view.scan_id);
  return captures.some((capture) => capture.id === scan?.capture_id && capture.origin === "demo");
}

/** The number keys choose a colour mode; they rest while something is being typed. */
function useColourKeys(colours: readonly ColourMode[], choose: (colour: ColourMode) => void): void {
  useEffect(() => {
    const pressed = (event: KeyboardEvent) => {
      const typing = event.target instanceof Element && event.target.closest("input, select, textarea");
      if (typing || event.ctrlKey || event.metaKey || event.altKey || !connected.peek()) return;
      const colour = colours[Number(event.key) - 1];
      if (colour !== undefined) choose(colour);
    };
    window.addEventListener("keydown", pressed);
    return () => window.removeEventListener("keydown", pressed);
  });
}
