// A take inside the page itself: what a server would say of it, without one. It can be looked at, not mended.

import { ABSENT, type Chunk, decode, frameOf, KINDS } from "./chunk";
import type { Findings, ProjectView, Series, TakeInfo, TakeView, Timeline, Why } from "./wire";

export interface EmbeddedTake {
  project: ProjectView;
  take: TakeView;
  timeline: Timeline;
  findings: Findings;
  /** Bytes in base 64: all samples, and the places of joints where there are any. */
  chunk: string;
  joints: string;
}

function bytes(text: string): ArrayBuffer {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
}

/** Graphs of a trajectory, frame by frame. */
function series(data: EmbeddedTake, chunk: Chunk, slot: number, first: number, last: number): Series {
  const rows = [...Array(Math.max(Math.min(last, chunk.frames) - first, 0)).keys()].map((i) => i + first);
  const place = (row: number, axis: number) =>
    row < 0 || row >= chunk.frames ? Number.NaN : chunk.xyz[3 * (row * chunk.slots + slot) + axis];
  const known = (v: number) => (Number.isFinite(v) ? v : null);
  const speed = (row: number) => {
    const moved = [0, 1, 2].map((a) => place(row + 1, a) - place(row - 1, a));
    return (Math.hypot(...moved) / 2000) * data.take.rate_hz;
  };
  const of = (values: Float32Array | null, row: number) => known(values?.[row * chunk.slots + slot] ?? Number.NaN);
  const values: Series["lows"] = {
    x: rows.map((r) => known(place(r, 0))),
    y: rows.map((r) => known(place(r, 1))),
    z: rows.map((r) => known(place(r, 2))),
    speed: rows.map((r) => known(speed(r))),
    residual: rows.map((r) => of(chunk.residual, r)),
    sigma: rows.map((r) => of(chunk.sigma, r)),
  };
  return { frames: rows.map((r) => r + data.take.first_frame), lows: values, highs: values };
}

function why(data: EmbeddedTake, chunk: Chunk, slot: number, frame: number): Why {
  const kind = frameOf(chunk, frame - data.take.first_frame).kind?.[slot] ?? ABSENT;
  const name = data.take.trajectories[slot].name;
  const text =
    kind === ABSENT ? `${name} is missing in frame ${frame}.` : `${name} is ${KINDS[kind]} in frame ${frame}.`;
  return { text, lines: [], rays: [] };
}

const here: TakeInfo["state"] = "ready";

/** What the page asks a server for, answered from the page; everything else needs the studio. */
export function embeddedApi(data: EmbeddedTake) {
  const samples = bytes(data.chunk);
  const chunk = decode(samples);
  return {
    project: async () => data.project,
    open: async (): Promise<TakeInfo> => ({ ...data.project.takes[0], state: here }),
    take: async () => data.take,
    timeline: async () => data.timeline,
    chunk: async () => samples,
    joints: async () => bytes(data.joints),
    series: async (_: string, slot: number, first: number, last: number) => series(data, chunk, slot, first, last),
    why: async (_: string, slot: number, frame: number) => why(data, chunk, slot, frame),
    findings: async () => data.findings,
  };
}
