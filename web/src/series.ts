// Thinned graphs as lines.

import type { Preview, Series } from "./wire";

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

/** The same with a gap as a method would fill it: three more columns, among the frames of the others. */
export function withPreview(data: (number | null)[][], preview: Preview): (number | null)[][] {
  const nothing = data.slice(1).map(() => null);
  const before = data[0].map((x, i) => [x as number, ...data.slice(1).map((c) => c[i]), null, null, null]);
  const filled = preview.xyz_mm.map((place, i) => [preview.first + i + 0.25, ...nothing, ...place]);
  const rows = [...before, ...filled].sort((a, b) => (a[0] as number) - (b[0] as number));
  return rows[0]?.map((_, k) => rows.map((row) => row[k])) ?? data;
}
