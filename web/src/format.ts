/**
 * Every number on the page goes through here: narrow spaces between groups of digits, a no-break space before a
 * unit, a true minus, and "not known" where there is no value.
 */

const NARROW = "\u202f";
const SPACE = "\u00a0";
const MINUS = "\u2212";

export const NOT_KNOWN = "not known";

function grouped(digits: string): string {
  return digits.replace(/\B(?=(\d{3})+$)/g, NARROW);
}

/** A number with `decimals` places, groups of three and a true minus: 1 280.50. */
export function number(value: number | null | undefined, decimals = 0): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NOT_KNOWN;
  const text = Math.abs(value).toFixed(decimals);
  const [whole = "0", part] = text.split(".");
  // What rounds to nothing has no sign.
  const minus = value < 0 && Number(text) !== 0;
  return (minus ? MINUS : "") + grouped(whole) + (part === undefined ? "" : "." + part);
}

function withUnit(text: string, unit: string): string {
  return text === NOT_KNOWN ? text : text + SPACE + unit;
}

/** A number with its unit: −0.4 mm, 3 grey levels. */
export function quantity(value: number | null | undefined, unit: string, decimals = 0): string {
  return withUnit(number(value, decimals), unit);
}

/** A length in millimetres: 12.35 mm. */
export function millimetres(value_mm: number | null | undefined, decimals = 2): string {
  return withUnit(number(value_mm, decimals), "mm");
}

/** A share of one as a percentage: 0.634 is 63 %. */
export function percent(share: number | null | undefined, decimals = 0): string {
  return withUnit(number(share === null || share === undefined ? share : share * 100, decimals), "%");
}

/** A measured length of time: 0.4 s, then as an age. */
export function duration(value_s: number | null | undefined): string {
  const short = value_s !== null && value_s !== undefined && value_s >= 0 && value_s < 9.95;
  return short ? withUnit(number(value_s, 1), "s") : age(value_s);
}

/** An age in whole seconds: 4 s, 23 s, 4:50, 1:02:03. */
export function age(value_s: number | null | undefined): string {
  if (value_s === null || value_s === undefined || !Number.isFinite(value_s) || value_s < 0) return NOT_KNOWN;
  const total = Math.round(value_s);
  if (total < 60) return withUnit(number(total), "s");
  const seconds = String(total % 60).padStart(2, "0");
  const minutes = Math.floor(total / 60) % 60;
  const hours = Math.floor(total / 3600);
  return hours === 0 ? `${minutes}:${seconds}` : `${hours}:${String(minutes).padStart(2, "0")}:${seconds}`;
}

/** A remaining time, rounded because it is an estimate: about 5 s, about 20 s, about 4 min. */
export function remaining(value_s: number | null | undefined): string {
  if (value_s === null || value_s === undefined || !Number.isFinite(value_s) || value_s < 0) return NOT_KNOWN;
  if (value_s < 10) return withUnit(number(Math.max(1, Math.round(value_s))), "s");
  if (value_s < 60) return withUnit(number(Math.round(value_s / 5) * 5), "s");
  return withUnit(number(Math.round(value_s / 60)), "min");
}

/** A size of a file in decimal units: 12.4 MB. */
export function bytes(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NOT_KNOWN;
  const units = ["B", "kB", "MB", "GB", "TB"];
  let size = value;
  let step = 0;
  while (size >= 999.5 && step < units.length - 1) {
    size /= 1000;
    step += 1;
  }
  return withUnit(number(size, step === 0 || size >= 99.5 ? 0 : 1), units[step] ?? "B");
}

/** The time of day of an RFC 3339 instant, in the reader's zone: 14:22:05. */
export function clock(instant: string | number | Date): string {
  const date = new Date(instant);
  if (Number.isNaN(date.getTime())) return NOT_KNOWN;
  const two = (n: number) => String(n).padStart(2, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`;
}

/** `done` of `total`, in a unit: 958 of 1 500 frames. */
export function progress(done: number, total: number, unit: string): string {
  return `${number(done)} of ${number(total)}${SPACE}${unit}`;
}
