// Thinned graphs as lines.

import type { Series } from "./wire";

/** Least and largest of each bin, one after the other: a line through them shows every peak. */
export function drawn(series: Series, names: readonly string[]): (number | null)[][] {
  const data: (number | null)[][] = [[], ...names.map(() => [])];
  series.frames.forEach((frame, i) => {
    const width = (series.frames[i + 1] ?? frame + 1) - frame;
    data[0].push(frame, frame + Math.max(width / 2, 0.25));
    names.forEach((name, k) => {
      data[k + 1].push(series.lows[name]?.[i] ?? null, series.highs[name]?.[i] ?? null);
    });
  });
  return data;
}
