import { describe, expect, it } from "vitest";
import { gapAt, gaps, kindAt, moved, nextGap, runAt, showing, stretches, zoomed } from "../src/runs";

// Measured 0–9, gap 10–19, filled 20–24, measured 25–99.
const RUNS = [0, 10, 0, 20, 5, 2, 25, 75, 0];

describe("runs", () => {
  it("tell the kind of every row", () => {
    expect([0, 9, 10, 19, 20, 24, 25, 99, 100].map((r) => kindAt(RUNS, r))).toEqual([0, 0, -1, -1, 2, 2, 0, 0, -1]);
    expect(kindAt([], 3)).toBe(-1);
    expect(runAt(RUNS, 15)).toBe(1);
  });

  it("have gaps only where nothing is between samples", () => {
    expect(gaps(RUNS)).toEqual([{ first: 10, last: 19 }]);
    expect(gaps([5, 3, 0])).toEqual([]);
    expect(gapAt(RUNS, 12)).toEqual({ first: 10, last: 19 });
    expect(gapAt(RUNS, 9)).toBeNull();
  });

  it("lead to the next gap of some trajectories, and back", () => {
    const every = [RUNS, [0, 50, 0, 60, 40, 0], [3, 4, 0]];
    expect(nextGap(every, [0, 1, 2], 0, true)).toEqual({ slot: 0, first: 10, last: 19 });
    expect(nextGap(every, [0, 1, 2], 10, true)).toEqual({ slot: 1, first: 50, last: 59 });
    expect(nextGap(every, [0, 1, 2], 50, true)).toBeNull();
    expect(nextGap(every, [0, 1], 50, false)).toEqual({ slot: 0, first: 10, last: 19 });
    expect(nextGap(every, [1], 20, false)).toBeNull();
  });

  it("become stretches of pixels", () => {
    expect(stretches(RUNS, 0, 100, 100)).toEqual([
      [0, 10, 0],
      [20, 5, 2],
      [25, 75, 0],
    ]);
    expect(stretches(RUNS, 22, 42, 200)).toEqual([
      [0, 30, 2],
      [30, 170, 0],
    ]);
    expect(stretches(RUNS, 10, 20, 100)).toEqual([]);
  });

  it("show within a pixel what is not measured", () => {
    const many: number[] = [];
    for (let i = 0; i < 10_000; i += 1) many.push(2 * i, 1, i % 100 === 50 ? 2 : 0);
    const shown = stretches(many, 0, 20_000, 100);
    expect(shown.length).toBeLessThanOrEqual(101);
    expect(shown.every(([, , kind]) => kind === 2)).toBe(true);
  });
});

describe("the window of frames", () => {
  it("zooms about a row and stays within the take", () => {
    expect(zoomed({ low: 0, high: 1000 }, 0.5, 500, 1000)).toEqual({ low: 250, high: 750 });
    expect(zoomed({ low: 0, high: 1000 }, 0.5, 0, 1000)).toEqual({ low: 0, high: 500 });
    expect(zoomed({ low: 400, high: 600 }, 100, 500, 1000)).toEqual({ low: 0, high: 1000 });
    expect(zoomed({ low: 0, high: 20 }, 0.01, 10, 1000).high).toBeLessThanOrEqual(15);
    expect(zoomed({ low: 0, high: 4 }, 0.1, 2, 4)).toEqual({ low: 0, high: 4 });
  });

  it("moves and follows the frame", () => {
    expect(moved({ low: 0, high: 100 }, -50, 1000)).toEqual({ low: 0, high: 100 });
    expect(moved({ low: 0, high: 100 }, 5000, 1000)).toEqual({ low: 900, high: 1000 });
    const window = { low: 100, high: 200 };
    expect(showing(window, 150, 1000)).toBe(window);
    expect(showing(window, 250, 1000).high).toBeGreaterThan(250);
    expect(showing(window, 50, 1000).low).toBeLessThanOrEqual(50);
  });
});
