import { describe, expect, it } from "vitest";
import { problemFrom } from "../src/api/problem";
import { bySource, leftOut } from "../src/scan/counts";
import { decimalsFor } from "../src/scan/legend";
import { refusal } from "../src/scan/zip-drop";
import { named } from "../src/texts";

describe("counts", () => {
  const counts = { laser2: 100, laser1: 300, saturated: 5, edge: 70, dark: 0 };
  it("part points by source, in a fixed order, with shares of all points", () => {
    expect(bySource(counts).map(({ name, share }) => [name, share])).toEqual([
      ["laser1", 0.75],
      ["laser2", 0.25],
    ]);
  });
  it("put the largest reason first and leave zeros out", () => {
    expect(leftOut(counts).map((row) => row.name)).toEqual(["edge", "saturated"]);
  });
  it("may be empty", () => expect(bySource({})).toEqual([]));
});

describe("a legend", () => {
  it.each([
    [200, 0],
    [40, 1],
    [0.11, 3],
    [0, 1],
    [1e-9, 4],
  ])("over %d has %d decimals", (width, decimals) => expect(decimalsFor(width)).toBe(decimals));
});

describe("a dropped file", () => {
  it("must be a zip within the server's limit", () => {
    expect(refusal({ name: "bust.ZIP", size: 10 }, 100)).toBeNull();
    expect(refusal({ name: "bust.rar", size: 10 }, 100)).toContain("bust.rar is not a zip");
    expect(refusal({ name: "bust.zip", size: 200 }, 100)).toContain("200");
  });
});

describe("an error", () => {
  it("keeps the server's words, code and fields", () => {
    const problem = problemFrom(
      { code: "bad-request", detail: "every is 0", fields: [{ field: "every", detail: "1 or more" }, "junk"] },
      422,
    );
    expect(problem).toMatchObject({ code: "bad-request", detail: "every is 0" });
    expect(problem.fields).toEqual([{ field: "every", detail: "1 or more" }]);
  });
  it("that is no problem document names its status", () => {
    expect(problemFrom(null, 502).detail).toContain("502");
  });
});

describe("a name the server may add", () => {
  it("is shown with spaces where there is no text for it", () => {
    expect(named({}, "off-sheet_limit")).toBe("Off sheet limit");
    expect(named({ steger: "Steger" }, "steger")).toBe("Steger");
  });
});
