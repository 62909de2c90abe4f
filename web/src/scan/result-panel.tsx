import { showScan } from "../api/client";
import type { Job, Scan } from "../api/types";
import { bytes, duration, millimetres, number, percent } from "../format";
import { Button } from "../parts/button";
import { Icon } from "../parts/icon";
import { ProblemNote } from "../parts/message";
import { Panel } from "../parts/panel";
import { connected, mirror } from "../state/server";
import { named, texts } from "../texts";
import { useAct } from "./act";
import { Again } from "./again";
import { FrameProblems, Warnings } from "./findings";
import { bySource, leftOut } from "./counts";

/** What a finished scan holds, how sure it is, what went wrong on the way, and its files. */
export function ResultPanel({ scan, job }: { scan: Scan; job: Job | null }) {
  const act = useAct();
  const shown = mirror.value?.view.scan_id === scan.id;
  return (
    <Panel
      title={scan.name}
      id="job"
      aside={
        <span class="tag ok">
          <Icon name="check" />
          {texts.job.states.done}
        </span>
      }
      footer={<Again job={job} />}
    >
      <div class="body stack-3">
        <Figures scan={scan} />
        <Downloads scan={scan} />
        {!shown && scan.allowed.includes("show") && (
          <Button
            icon="cube"
            busy={act.busy}
            off={connected.value ? null : texts.link.refused}
            onPress={() => act.run(() => showScan(scan.id))}
          >
            {texts.result.show}
          </Button>
        )}
        {act.problem && <ProblemNote problem={act.problem} onDismiss={act.forget} />}
        <Sources scan={scan} />
        <Warnings warnings={scan.warnings} />
        <FrameProblems scan={scan} />
        <Details scan={scan} />
      </div>
    </Panel>
  );
}

function Figures({ scan }: { scan: Scan }) {
  return (
    <dl class="figures">
      <div>
        <dt>{texts.result.points}</dt>
        <dd class="figure">{number(scan.points)}</dd>
      </div>
      <div>
        <dt title={texts.result.sigmaHint}>{texts.result.sigma}</dt>
        <dd class="figure">
          {number(scan.median_sigma_mm, 3)} <small>{scan.median_sigma_mm === null ? "" : texts.result.sigmaUnit}</small>
        </dd>
      </div>
    </dl>
  );
}

function Downloads({ scan }: { scan: Scan }) {
  return (
    <ul class="downloads" aria-label={texts.result.download}>
      {scan.files.map((file, index) => {
        const kind = named(texts.result.files, file.name);
        const size = bytes(file.bytes);
        return (
          <li key={file.name}>
            <a
              class={`button big wide ${index === 0 ? "primary" : "plain"}`}
              href={file.url}
              download={`${scan.name}-${file.name}`}
              aria-label={texts.result.fileLabel(kind, size)}
            >
              <Icon name="download" />
              {kind} <small>{size}</small>
            </a>
            <p class="small muted">{texts.result.filesHint[file.name] ?? ""}</p>
          </li>
        );
      })}
    </ul>
  );
}

function Sources({ scan }: { scan: Scan }) {
  const parts = bySource(scan.counts);
  if (parts.length === 0) return null;
  const spoken = parts.map((part) => `${named(texts.sources, part.name)} ${percent(part.share)}`).join(", ");
  return (
    <div class="stack-1">
      <h3>{texts.result.bySource}</h3>
      <div class="bar-stack" role="img" aria-label={texts.result.bySourceLabel(spoken)}>
        {parts.map((part) => (
          <i key={part.name} style={{ flexGrow: part.count, background: `var(--src-${part.name})` }} />
        ))}
      </div>
      <ul class="legend">
        {parts.map((part) => (
          <li key={part.name}>
            <i class={`letter ${part.name}`} style={{ background: `var(--src-${part.name})` }}>
              {part.letter}
            </i>
            {named(texts.sources, part.name)} {percent(part.share)}
          </li>
        ))}
      </ul>
    </div>
  );
}

/** Along the travel by across it. */
function extent(scan: Scan): string {
  if (scan.bounds_mm === null) return number(null);
  const { min, max } = scan.bounds_mm;
  return `${number(max[0] - min[0], 1)} × ${millimetres(max[1] - min[1], 1)}`;
}

function heights(scan: Scan): string {
  if (scan.bounds_mm === null) return number(null);
  return `${number(scan.bounds_mm.min[2], 2)} … ${millimetres(scan.bounds_mm.max[2])}`;
}

function Details({ scan }: { scan: Scan }) {
  const dropped = leftOut(scan.counts);
  const rows: readonly (readonly [string, string])[] = [
    [texts.result.frames, texts.result.framesOf(number(scan.frames_used), number(scan.frames))],
    [texts.result.extent, extent(scan)],
    [texts.result.heights, heights(scan)],
    [texts.result.method, `${named(texts.methods, scan.method)}, ${texts.own.summaryEvery(number(scan.every))}`],
    [texts.result.rig, `${scan.rig.id}, ${named(texts.result.rigOrigins, scan.rig.origin)}`],
    [texts.result.time, duration(scan.elapsed_s)],
  ];
  return (
    <>
      <dl class="pairs">
        {rows.map(([key, value]) => (
          <div key={key}>
            <dt>{key}</dt>
            <dd>{value}</dd>
          </div>
        ))}
      </dl>
      {dropped.length > 0 && (
        <details>
          <summary>{texts.result.leftOut}</summary>
          <p class="small muted">{texts.result.leftOutHint}</p>
          <dl class="pairs">
            {dropped.map((row) => (
              <div key={row.name}>
                <dt>{named({}, row.name)}</dt>
                <dd>{number(row.count)}</dd>
              </div>
            ))}
          </dl>
        </details>
      )}
    </>
  );
}
