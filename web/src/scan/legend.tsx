import type { View } from "../api/types";
import { number, quantity } from "../format";
import { texts } from "../texts";

/** What the colours of the 3-D view mean. */
export function Legend({ view }: { view: View }) {
  if (view.colour === "source") return <SourceLegend />;
  if (view.legend === null) return <span class="faint">{texts.stage.colourNote}</span>;
  const { min, max, unit } = view.legend;
  const decimals = decimalsFor(max - min);
  const low = number(min, decimals);
  const high = number(max, decimals);
  return (
    <div class="ramp" role="img" aria-label={texts.stage.legend(texts.stage.colours[view.colour], low, high, unit)}>
      <span>{low}</span>
      <i />
      <span>{quantity(max, unit, decimals)}</span>
    </div>
  );
}

function SourceLegend() {
  const sources = [
    ["laser1", "1"],
    ["laser2", "2"],
    ["both", "B"],
  ] as const;
  return (
    <ul class="legend">
      {sources.map(([source, letter]) => (
        <li key={source}>
          <i class={`letter ${source}`} style={{ background: `var(--src-${source})` }}>
            {letter}
          </i>
          {texts.sources[source]}
        </li>
      ))}
    </ul>
  );
}

/** Decimals that tell the ends of a range apart: three figures of its width. */
export function decimalsFor(width: number): number {
  if (!(width > 0)) return 1;
  return Math.min(4, Math.max(0, 2 - Math.floor(Math.log10(width))));
}
