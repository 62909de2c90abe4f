/** What a scan has to say against itself. */

import type { Scan } from "../api/types";
import { number } from "../format";
import { Icon } from "../parts/icon";
import { texts } from "../texts";

export function Warnings({ warnings }: { warnings: readonly string[] }) {
  if (warnings.length === 0) return null;
  return (
    <div class="stack-1">
      <h3>{texts.result.warnings}</h3>
      <ul class="rows">
        {warnings.map((warning) => (
          <li key={warning}>
            <Icon name="alert" class="warn" />
            <span>{warning}</span>
          </li>
        ))}
      </ul>
    </div>
  );
}

export function FrameProblems({ scan }: { scan: Scan }) {
  if (scan.problem_count === 0) return null;
  const rest = scan.problem_count - scan.problems.length;
  return (
    <details id="frame-problems">
      <summary>
        <Icon name="alert" class="warn" />
        {texts.result.problems(number(scan.problem_count))}
      </summary>
      <ul class="rows scrolling">
        {scan.problems.map((problem) => (
          <li key={problem.frame}>
            <span>
              <span class="code">{problem.frame}</span> {problem.reason}
            </span>
          </li>
        ))}
        {rest > 0 && <li class="muted">{texts.result.problemsMore(number(rest))}</li>}
      </ul>
    </details>
  );
}
