/** An own capture: where it is, how to compute it, and the start. */

import { useRef, useState } from "preact/hooks";
import { openFolder, startJob, uploadCapture, uploadRig } from "../api/client";
import { asProblem, type ServerProblem } from "../api/problem";
import type { Capture, System } from "../api/types";
import { number, percent } from "../format";
import { Button } from "../parts/button";
import { Icon } from "../parts/icon";
import { ProblemNote, Skeleton } from "../parts/message";
import { Panel } from "../parts/panel";
import { Progress } from "../parts/progress";
import { Segmented } from "../parts/segmented";
import { ended } from "../state/mirror";
import { connected, job, mirror } from "../state/server";
import { named, texts } from "../texts";
import { CaptureSettings } from "./capture-settings";
import { EMPTY_DRAFT, everyOf, methodOf, missing, requestOf, sourcesOf, type Draft, type Origin } from "./draft";
import { ZipDrop } from "./zip-drop";

/** What is going on: nothing, a step without measure, or an upload with the share that was sent. */
type Step = "opening" | "rig" | "starting" | { readonly sent: number };

export function CapturePanel() {
  const known = mirror.value;
  if (known === null) {
    return (
      <Panel title={texts.own.title} id="own">
        <Skeleton slow={false} />
      </Panel>
    );
  }
  return <CaptureForm system={known.system} captures={known.captures} />;
}

function CaptureForm({ system, captures }: { system: System; captures: readonly Capture[] }) {
  const [draft, setDraft] = useState<Draft>(EMPTY_DRAFT);
  const [problem, setProblem] = useState<ServerProblem | null>(null);
  const { step, start } = useStart(system, setProblem);
  const change = (part: Partial<Draft>) => {
    setDraft({ ...draft, ...part });
    setProblem(null);
  };
  const off = connected.value ? missing(draft, system) : texts.link.refused;
  const queued = job.value !== null && !ended(job.value);
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        if (off === null && step === null) start(draft);
      }}
      noValidate
    >
      <Panel
        title={texts.own.title}
        id="own"
        footer={
          <div class="stack-2">
            <Button submit wide icon="play" busy={step !== null} off={off}>
              {step === null ? (queued ? texts.own.queue : texts.own.start) : stepText(step)}
            </Button>
            {step !== null && typeof step === "object" && <Progress label={stepText(step)} share={step.sent} />}
            {step === null && off !== null && (
              <p class="why">
                <Icon name="info" />
                {off}
              </p>
            )}
          </div>
        }
      >
        <div class="body stack-3">
          <OriginChoice draft={draft} captures={captures} change={change} />
          <OriginFields draft={draft} system={system} captures={captures} change={change} problem={problem} />
          {problem && <ProblemNote problem={problem} onDismiss={() => setProblem(null)} />}
          <details>
            <summary>
              {texts.own.settings}
              <span class="muted cut">{summaryOf(draft, system)}</span>
            </summary>
            <CaptureSettings draft={draft} system={system} change={change} problem={problem} />
          </details>
        </div>
      </Panel>
    </form>
  );
}

interface FieldsProps {
  draft: Draft;
  captures: readonly Capture[];
  change: (part: Partial<Draft>) => void;
}

function OriginChoice({ draft, captures, change }: FieldsProps) {
  const origins: readonly Origin[] = captures.length > 0 ? ["folder", "zip", "known"] : ["folder", "zip"];
  return (
    <Segmented
      label={texts.own.from}
      fill
      value={draft.origin}
      onChoose={(origin) => change({ origin, knownId: draft.knownId ?? captures[0]?.id ?? null })}
      choices={origins.map((value) => ({ value, text: texts.own[value] }))}
    />
  );
}

function OriginFields(props: FieldsProps & { system: System; problem: ServerProblem | null }) {
  const { draft, system, captures, change, problem } = props;
  if (draft.origin === "zip") {
    return <ZipDrop file={draft.zip} limit_bytes={system.limits.upload_bytes} onFile={(zip) => change({ zip })} />;
  }
  if (draft.origin === "known") {
    return (
      <div class="field">
        <label for="own-known">{texts.own.capture}</label>
        <select
          class="input"
          id="own-known"
          value={draft.knownId ?? ""}
          onChange={(event) => change({ knownId: event.currentTarget.value })}
        >
          {captures.map((capture) => (
            <option key={capture.id} value={capture.id}>
              {texts.own.captureLine(capture.name, number(capture.laser_frames))}
            </option>
          ))}
        </select>
      </div>
    );
  }
  const wrong = problem?.code === "bad-capture" || problem?.fields.some((field) => field.field === "path");
  return (
    <div class="field">
      <label for="own-path">{texts.own.path}</label>
      <input
        class={`input ${wrong ? "bad" : ""}`}
        id="own-path"
        type="text"
        spellcheck={false}
        autocomplete="off"
        placeholder={texts.own.pathPlaceholder}
        value={draft.path}
        aria-invalid={wrong}
        aria-describedby="own-path-hint"
        onInput={(event) => change({ path: event.currentTarget.value })}
      />
      <p class="hint" id="own-path-hint">
        {texts.own.pathHint}
      </p>
    </div>
  );
}

function summaryOf(draft: Draft, system: System): string {
  const lasers = sourcesOf(draft, system).map((source) => named(texts.sources, source));
  const every = everyOf(draft);
  return texts.own.summary(
    named(texts.methods, methodOf(draft, system)),
    lasers.join(", ").toLowerCase(),
    texts.own.summaryEvery(every === null ? draft.every : number(every)),
  );
}

function stepText(step: Step): string {
  return typeof step === "string" ? texts.own.busy[step] : texts.own.busy.uploading(percent(step.sent));
}

/** Capture, rig, job: one after the other. What has arrived is not sent again when a later step fails. */
function useStart(system: System, setProblem: (problem: ServerProblem | null) => void) {
  const [step, setStep] = useState<Step | null>(null);
  const arrived = useRef<{ readonly of: File | string; readonly capture: Capture } | null>(null);

  async function captureOf(draft: Draft): Promise<Pick<Capture, "id">> {
    if (draft.origin === "known" && draft.knownId !== null) return { id: draft.knownId };
    const of = draft.origin === "zip" && draft.zip !== null ? draft.zip : draft.path.trim();
    const still = mirror.peek()?.captures.some((capture) => capture.id === arrived.current?.capture.id);
    if (arrived.current?.of === of && typeof of !== "string" && still) return arrived.current.capture;
    setStep(typeof of === "string" ? "opening" : { sent: 0 });
    const capture =
      typeof of === "string" ? await openFolder(of) : await uploadCapture(of, (sent) => setStep({ sent }));
    arrived.current = { of, capture };
    return capture;
  }

  async function work(draft: Draft): Promise<void> {
    const capture = await captureOf(draft);
    if (draft.rig === "file" && draft.rigFile !== null) {
      setStep("rig");
      await uploadRig(capture.id, draft.rigFile);
    }
    setStep("starting");
    await startJob(requestOf(draft, system, capture));
  }

  const start = (draft: Draft): void => {
    setProblem(null);
    setStep("starting");
    work(draft)
      .catch((thrown: unknown) => setProblem(asProblem(thrown)))
      .finally(() => setStep(null));
  };
  return { step, start };
}
