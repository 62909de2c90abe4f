import { useState } from "preact/hooks";
import { startJob } from "../api/client";
import type { JobRequest } from "../api/types";
import { Button } from "../parts/button";
import { Icon } from "../parts/icon";
import { ProblemNote } from "../parts/message";
import { Panel } from "../parts/panel";
import { connected, mirror } from "../state/server";
import { texts } from "../texts";
import { useAct } from "./act";

const STEP_ICONS = ["scan", "stripe", "cube"] as const;

/** The first visit: from nothing to a cloud in a minute. */
export function DemoPanel() {
  const act = useAct();
  const scenes = mirror.value?.system.scenes ?? [];
  const [chosen, choose] = useState<string | null>(null);
  const scene = chosen ?? scenes[0]?.name;
  return (
    <Panel title={texts.demo.panel} id="job">
      <div class="body roomy stack-3">
        <p class="title">{texts.demo.title}</p>
        <p class="soft">{texts.demo.intro}</p>
        {scenes.length > 1 && (
          <div class="field">
            <label for="demo-scene">{texts.demo.scene}</label>
            <select class="input" id="demo-scene" value={scene} onChange={(event) => choose(event.currentTarget.value)}>
              {scenes.map(({ name, title }) => (
                <option key={name} value={name}>
                  {texts.scenes[name] ?? title}
                </option>
              ))}
            </select>
          </div>
        )}
        <DemoButton scene={scene} act={act} />
        {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
        <ul class="phases invitation">
          {texts.demo.steps.map((step, index) => (
            <li class="todo" key={step}>
              <Icon name={STEP_ICONS[index] ?? "check"} />
              <span>{step}</span>
            </li>
          ))}
        </ul>
      </div>
    </Panel>
  );
}

function DemoButton({ scene, act }: { scene: string | undefined; act: ReturnType<typeof useAct> }) {
  const request: JobRequest = { kind: "demo", ...(scene === undefined ? {} : { scene }) };
  return (
    <Button
      kind="primary"
      size="big"
      wide
      icon="play"
      busy={act.busy}
      off={connected.value ? null : texts.link.refused}
      onPress={() => act.run(() => startJob(request))}
    >
      {texts.demo.run}
    </Button>
  );
}
