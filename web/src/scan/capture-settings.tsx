import type { ServerProblem } from "../api/problem";
import type { System } from "../api/types";
import { Icon } from "../parts/icon";
import { named, texts } from "../texts";
import { everyOf, methodOf, sourcesOf, type Draft, type RigChoice } from "./draft";

interface SettingsProps {
  draft: Draft;
  system: System;
  change: (part: Partial<Draft>) => void;
  problem: ServerProblem | null;
}

/** How a capture is computed. */
export function CaptureSettings({ draft, system, change, problem }: SettingsProps) {
  return (
    <div class="stack-2 settings">
      <div class="field">
        <label for="own-method">{texts.own.method}</label>
        <select
          class="input"
          id="own-method"
          value={methodOf(draft, system)}
          onChange={(event) => change({ method: event.currentTarget.value })}
        >
          {system.methods.map((method) => (
            <option key={method} value={method}>
              {named(texts.methods, method)}
            </option>
          ))}
        </select>
      </div>
      <Sources draft={draft} system={system} change={change} />
      <Every draft={draft} change={change} problem={problem} />
      <Rig draft={draft} change={change} />
    </div>
  );
}

function Sources({ draft, system, change }: Omit<SettingsProps, "problem">) {
  const chosen = sourcesOf(draft, system);
  return (
    <div class="field" role="group" aria-labelledby="own-sources">
      <span class="label" id="own-sources">
        {texts.own.sources}
      </span>
      <div class="row wrap">
        {system.sources.map((source) => (
          <label class="check" key={source}>
            <input
              type="checkbox"
              checked={chosen.includes(source)}
              onChange={(event) =>
                change({
                  sources: event.currentTarget.checked
                    ? [...chosen, source]
                    : chosen.filter((other) => other !== source),
                })
              }
            />
            {named(texts.sources, source)}
          </label>
        ))}
      </div>
    </div>
  );
}

function Every({ draft, change, problem }: Pick<SettingsProps, "draft" | "change" | "problem">) {
  const told = problem?.fields.find((field) => field.field === "every")?.detail;
  const wrong = told ?? (everyOf(draft) === null ? texts.own.everyWrong : null);
  return (
    <div class="field">
      <label for="own-every">{texts.own.every}</label>
      <input
        class={`input short ${wrong ? "bad" : ""}`}
        id="own-every"
        type="text"
        inputMode="numeric"
        value={draft.every}
        aria-invalid={wrong !== null}
        aria-describedby="own-every-hint"
        onInput={(event) => change({ every: event.currentTarget.value })}
      />
      <p class={`hint ${wrong ? "fail" : ""}`} id="own-every-hint">
        {wrong ?? texts.own.everyHint}
      </p>
    </div>
  );
}

const RIGS: Readonly<Record<RigChoice, string>> = {
  auto: texts.own.rigAuto,
  nominal: texts.own.rigNominal,
  file: texts.own.rigFile,
};

function Rig({ draft, change }: Pick<SettingsProps, "draft" | "change">) {
  return (
    <div class="field">
      <label for="own-rig">{texts.own.rig}</label>
      <select
        class="input"
        id="own-rig"
        value={draft.rig}
        onChange={(event) => change({ rig: event.currentTarget.value as RigChoice })}
      >
        {Object.entries(RIGS).map(([value, text]) => (
          <option key={value} value={value}>
            {text}
          </option>
        ))}
      </select>
      {draft.rig === "file" && (
        <label class="file-line">
          <input
            class="visually-hidden"
            type="file"
            accept=".json,application/json"
            onChange={(event) => change({ rigFile: event.currentTarget.files?.[0] ?? null })}
          />
          <span class="button plain small">
            <Icon name="file" />
            {texts.own.rigChoose}
          </span>
          <span class="small muted cut">{draft.rigFile?.name ?? texts.own.rigNone}</span>
        </label>
      )}
    </div>
  );
}
