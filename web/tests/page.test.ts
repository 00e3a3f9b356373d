import { describe, expect, it } from "vitest";
import { written } from "../src/keys";
import { drawn, withPreview } from "../src/series";
import { after, signal } from "../src/store";
import { heat, markerColor } from "../src/theme";

describe("signals", () => {
  it("tell of changes, and only of changes", () => {
    const seen: number[] = [];
    const one = signal(1);
    const stop = one.on((v) => seen.push(v));
    one.set(1);
    one.set(2);
    one.update((v) => v + 1);
    stop();
    one.set(9);
    expect(seen).toEqual([2, 3]);
  });

  it("are gathered: one piece of work for many changes", async () => {
    const [a, b] = [signal(0), signal(0)];
    let work = 0;
    after([a, b], () => work++);
    for (let i = 1; i < 5; i += 1) {
      a.set(i);
      b.set(i);
    }
    await Promise.resolve();
    expect(work).toBe(1);
  });
});

describe("graphs", () => {
  it("go through the least and the largest of each bin, and break where nothing is", () => {
    const series = { frames: [10, 20, 30], lows: { x: [1, null, 3] }, highs: { x: [2, null, 9] } };
    expect(drawn(series, ["x"])).toEqual([
      [10, 15, 20, 25, 30, 30.5],
      [1, 2, null, null, 3, 9],
    ]);
  });
});

describe("a preview in the graphs", () => {
  it("lies among the frames of its gap", () => {
    const data = [
      [9, 9.5, 12, 12.5],
      [1, 1, 4, 4],
      [1, 1, 4, 4],
      [1, 1, 4, 4],
    ];
    const preview = {
      method: "rigid",
      first: 10,
      xyz_mm: [[2, 3, 4] as [number, number, number]],
      expected_mm: 1,
      reason: "",
    };
    expect(withPreview(data, preview)).toEqual([
      [9, 9.5, 10.25, 12, 12.5],
      [1, 1, null, 4, 4],
      [1, 1, null, 4, 4],
      [1, 1, null, 4, 4],
      [null, null, 2, null, null],
      [null, null, 3, null, null],
      [null, null, 4, null, null],
    ]);
  });
});

describe("keys", () => {
  it("are written as in the list of shortcuts", () => {
    const key = (k: string, more = {}) => written({ key: k, ctrlKey: false, metaKey: false, shiftKey: false, ...more });
    expect(key(" ")).toBe("Space");
    expect(key("G", { shiftKey: true })).toBe("Shift+G");
    expect(key("?", { shiftKey: true })).toBe("?");
    expect(key("ArrowLeft", { shiftKey: true })).toBe("Shift+ArrowLeft");
    expect(key("z", { metaKey: true })).toBe("Ctrl+z");
    expect(key("Z", { ctrlKey: true, shiftKey: true })).toBe("Ctrl+Shift+Z");
  });
});

describe("colours", () => {
  it("are the marker set's, or from a palette for names, or grey", () => {
    expect(markerColor("#123456", "LASI", 0)).toBe("#123456");
    expect(markerColor("", "LASI", 0)).not.toBe(markerColor("", "", 0));
    expect(heat(0)).not.toBe(heat(1));
    expect(heat(-5)).toBe(heat(0));
  });
});
