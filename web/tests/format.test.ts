import { describe, expect, it } from "vitest";
import {
  age,
  bytes,
  clock,
  duration,
  millimetres,
  number,
  percent,
  progress,
  quantity,
  remaining,
} from "../src/format";

/** Spaces made visible, since the formats differ by them: `'` between groups, `_` before a unit. */
const shown = (text: string) => text.replaceAll("\u202f", "'").replaceAll("\u00a0", "_");

describe("number", () => {
  it("groups digits by three and leaves decimals whole", () => {
    expect(shown(number(1280))).toBe("1'280");
    expect(shown(number(1234567.1234, 4))).toBe("1'234'567.1234");
    expect(number(999)).toBe("999");
  });
  it("writes a true minus", () => {
    expect(number(-0.4, 1)).toBe("\u22120.4");
    expect(shown(number(-1280))).toBe("\u22121'280");
  });
  it("never writes minus zero", () => {
    expect(number(-0.04, 1)).toBe("0.0");
  });
  it.each([null, undefined, Number.NaN, Number.POSITIVE_INFINITY])("says that %s is not known", (value) => {
    expect(number(value)).toBe("not known");
    expect(millimetres(value)).toBe("not known");
    expect(percent(value)).toBe("not known");
    expect(duration(value)).toBe("not known");
    expect(remaining(value)).toBe("not known");
    expect(bytes(value)).toBe("not known");
  });
});

describe("units", () => {
  it("stand behind a no-break space", () => {
    expect(shown(millimetres(12.345))).toBe("12.35_mm");
    expect(shown(percent(0.634))).toBe("63_%");
    expect(shown(quantity(3, "grey levels"))).toBe("3_grey levels");
    expect(shown(progress(958, 1500, "frames"))).toBe("958 of 1'500_frames");
  });
});

describe("times", () => {
  it.each([
    [0.44, "0.4_s"],
    [9.96, "10_s"],
    [59.4, "59_s"],
    [59.6, "1:00"],
    [290, "4:50"],
    [3723, "1:02:03"],
  ])("%d s of work is %s", (seconds, text) => expect(shown(duration(seconds))).toBe(text));
  it("an age has whole seconds", () => expect(shown(age(4.2))).toBe("4_s"));
  it.each([
    [0.2, "1_s"],
    [7.4, "7_s"],
    [23, "25_s"],
    [57, "55_s"],
    [58, "60_s"],
    [95, "2_min"],
    [5400, "90_min"],
  ])("an estimate of %d s is rounded to %s", (seconds, text) => expect(shown(remaining(seconds))).toBe(text));
  it("an instant is the reader's time of day", () => {
    expect(clock("2026-11-22T04:59:03.120Z")).toMatch(/^\d\d:\d\d:03$/);
    expect(clock("yesterday")).toBe("not known");
  });
});

describe("bytes", () => {
  it.each([
    [0, "0_B"],
    [999, "999_B"],
    [1000, "1.0_kB"],
    [999_950, "1.0_MB"],
    [16_234_567, "16.2_MB"],
    [4_294_967_296, "4.3_GB"],
  ])("%d is %s", (size, text) => expect(shown(bytes(size))).toBe(text));
});
