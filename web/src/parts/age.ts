/** A clock that ticks only while something looks at it. */

import { useEffect, useState } from "preact/hooks";

/** The present time in milliseconds, renewed each second while `running`. */
export function useNow(running: boolean): number {
  const [now, setNow] = useState(Date.now());
  useEffect(() => {
    if (!running) return;
    setNow(Date.now());
    const timer = setInterval(() => setNow(Date.now()), 1000);
    return () => clearInterval(timer);
  }, [running]);
  return now;
}

/** True once `delay_ms` have passed since the component came to be. */
export function useElapsed(delay_ms: number): boolean {
  const [elapsed, setElapsed] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setElapsed(true), delay_ms);
    return () => clearTimeout(timer);
  }, [delay_ms]);
  return elapsed;
}
