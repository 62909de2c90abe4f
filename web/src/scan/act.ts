/** One command at a time, with its error kept for the reader. */

import { useState } from "preact/hooks";
import { asProblem, type ServerProblem } from "../api/problem";

export interface Act {
  readonly busy: boolean;
  readonly problem: ServerProblem | null;
  readonly forget: () => void;
  readonly run: (work: () => Promise<unknown>) => void;
}

export function useAct(): Act {
  const [busy, setBusy] = useState(false);
  const [problem, setProblem] = useState<ServerProblem | null>(null);
  return {
    busy,
    problem,
    forget: () => setProblem(null),
    run: (work) => {
      setBusy(true);
      setProblem(null);
      work()
        .catch((thrown: unknown) => setProblem(asProblem(thrown)))
        .finally(() => setBusy(false));
    },
  };
}
