/** The server's counts, parted into points by source and stripe positions that gave none. */

const SOURCES = [
  ["laser1", "1"],
  ["laser2", "2"],
  ["both", "B"],
  ["tof", "T"],
  ["filled", "F"],
] as const;

export type SourceName = (typeof SOURCES)[number][0];

export interface SourceCount {
  readonly name: SourceName;
  readonly letter: string;
  readonly count: number;
  /** Of all points, from 0 to 1. */
  readonly share: number;
}

/** Sources that gave points, in a fixed order. */
export function bySource(counts: Readonly<Record<string, number>>): readonly SourceCount[] {
  const total = SOURCES.reduce((sum, [name]) => sum + (counts[name] ?? 0), 0);
  return SOURCES.flatMap(([name, letter]) => {
    const count = counts[name] ?? 0;
    return count > 0 ? [{ name, letter, count, share: count / total }] : [];
  });
}

/** Everything else that was counted, largest first. */
export function leftOut(counts: Readonly<Record<string, number>>): readonly { name: string; count: number }[] {
  const sources = new Set<string>(SOURCES.map(([name]) => name));
  return Object.entries(counts)
    .filter(([name, count]) => !sources.has(name) && count > 0)
    .map(([name, count]) => ({ name, count }))
    .sort((a, b) => b.count - a.count);
}
