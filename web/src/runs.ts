// Runs of samples of one kind: flat triples start, length, kind, in order. Rows count from 0, the first frame of the take.

export type Runs = readonly number[];
export interface Gap {
  first: number;
  last: number;
}

/** Place in `runs` of the first run that ends after a row. */
export function runAt(runs: Runs, row: number): number {
  let low = 0;
  let high = runs.length / 3;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (runs[3 * middle] + runs[3 * middle + 1] > row) high = middle;
    else low = middle + 1;
  }
  return low;
}

/** Kind of the sample in a row; −1 where there is none. */
export function kindAt(runs: Runs, row: number): number {
  const i = runAt(runs, row);
  return 3 * i < runs.length && runs[3 * i] <= row ? runs[3 * i + 2] : -1;
}

/** Gaps between the first and the last sample. */
export function gaps(runs: Runs): Gap[] {
  const found: Gap[] = [];
  for (let i = 3; i < runs.length; i += 3) {
    const end = runs[i - 3] + runs[i - 2];
    if (runs[i] > end) found.push({ first: end, last: runs[i] - 1 });
  }
  return found;
}

/** The gap that a row lies in. */
export function gapAt(runs: Runs, row: number): Gap | null {
  return gaps(runs).find((g) => g.first <= row && row <= g.last) ?? null;
}

/** The first gap after a row, or the last before it, over some trajectories. */
export function nextGap(every: readonly Runs[], slots: readonly number[], row: number, forward: boolean) {
  let best: (Gap & { slot: number }) | null = null;
  for (const slot of slots) {
    for (const gap of gaps(every[slot] ?? [])) {
      const ahead = forward ? gap.first > row : gap.first < row;
      if (!ahead) continue;
      if (best === null || (forward ? gap.first < best.first : gap.first > best.first)) best = { ...gap, slot };
    }
  }
  return best;
}

/** Stretches of a row of pixels, one for each run or for runs too short to be told apart: x, width, kind. */
export function stretches(runs: Runs, low: number, high: number, width: number): [number, number, number][] {
  const perRow = width / (high - low);
  const found: [number, number, number][] = [];
  for (let i = runAt(runs, low); 3 * i < runs.length && runs[3 * i] < high; i += 1) {
    const x0 = Math.max(0, (runs[3 * i] - low) * perRow);
    const x1 = Math.min(width, (runs[3 * i] + runs[3 * i + 1] - low) * perRow);
    const kind = runs[3 * i + 2];
    const before = found.at(-1);
    // Within a pixel what is not measured is shown: it is what one looks for.
    if (before !== undefined && x1 - before[0] < 1) {
      before[1] = Math.max(before[1], x1 - before[0]);
      before[2] = Math.max(before[2], kind);
    } else {
      found.push([x0, x1 - x0, kind]);
    }
  }
  return found;
}

export interface Window {
  low: number;
  high: number;
}

/** A window of frames made longer or shorter about a row, within the take. */
export function zoomed(window: Window, factor: number, about: number, total: number): Window {
  const length = Math.min(Math.max((window.high - window.low) * factor, Math.min(10, total)), total);
  const share = (about - window.low) / (window.high - window.low || 1);
  return moved({ low: about - share * length, high: about - share * length + length }, 0, total);
}

/** A window moved by some rows, within the take. */
export function moved(window: Window, by: number, total: number): Window {
  const length = Math.min(window.high - window.low, total);
  const low = Math.min(Math.max(window.low + by, 0), total - length);
  return { low, high: low + length };
}

/** A window that shows a row: the same one, or moved as little as needed. */
export function showing(window: Window, row: number, total: number): Window {
  if (row < window.low) return moved(window, row - window.low - 0.1 * (window.high - window.low), total);
  if (row >= window.high) return moved(window, row - window.high + 1 + 0.1 * (window.high - window.low), total);
  return window;
}
