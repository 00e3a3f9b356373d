// What the page is looking at.

import type { FrameStore } from "./frames";
import type { Runs, Window } from "./runs";
import { afterDrawing } from "./schedule";
import type { Selection } from "./selection";
import { signal } from "./store";
import type { AccuracyView, DotsView, Findings, Preview, ProjectView, RefinedView, TakeView, Why } from "./wire";

export type ColorBy = "label" | "kind" | "residual" | "confidence";

export interface Options {
  colorBy: ColorBy;
  names: boolean;
  trails: boolean;
  path: boolean;
  links: boolean;
  skeleton: boolean;
  cameras: boolean;
  rays: boolean;
  follow: boolean;
  up: "z" | "y";
  radius_mm: number;
  theme: "light" | "dark" | null;
  view: "3d" | "2d" | "both";
  graph: string;
}

const DEFAULTS: Options = {
  colorBy: "label",
  names: false,
  trails: true,
  path: false,
  links: true,
  skeleton: true,
  cameras: true,
  rays: true,
  follow: false,
  up: "z",
  radius_mm: 9,
  theme: null,
  view: "both",
  graph: "position",
};
const KEPT_AS = "markerloom.options";

function kept(): Options {
  try {
    return { ...DEFAULTS, ...JSON.parse(localStorage.getItem(KEPT_AS) ?? "{}") };
  } catch {
    return DEFAULTS;
  }
}

export const project = signal<ProjectView | null>(null);
export const take = signal<TakeView | null>(null);
export const runs = signal<readonly Runs[]>([]);
export const frames = signal<FrameStore | null>(null);
export const joints = signal<FrameStore | null>(null);
export const loaded = signal(0);
export const row = signal(0);
/** The frame that the 3D view has drawn with its samples; none where there is no 3D view. */
export const drawnRow = signal<number | null>(null);
export const playing = signal(false);
export const speed = signal(1);
export const looping = signal(true);
export const selection = signal<Selection>([]);
/** Frames that are selected, as rows, both included. */
export const range = signal<{ first: number; last: number } | null>(null);
export const shown = signal<Window>({ low: 0, high: 1 });
export const findings = signal<Findings | null>(null);
export const camera = signal(0);
export const dots = signal<DotsView | null>(null);
export const chosenDot = signal<{ camera: string; frame: number; x: number; y: number } | null>(null);
export const region = signal<{ camera: string; low: [number, number]; high: [number, number] } | null>(null);
export const why = signal<Why | null>(null);
export const preview = signal<Preview | null>(null);
/** The planner's map, and the height of the layer that is shown. */
export const accuracy = signal<{ map: AccuracyView; layer: number } | null>(null);
export const refined = signal<RefinedView | null>(null);
export const online = signal(true);
/** While the page itself changes the take: what the server tells of that is no news. */
export const busy = signal(0);
export const sourceState = signal<"ok" | "changed" | "gone">("ok");
export const status = signal<{ text: string; bad: boolean }>({ text: "", bad: false });
export const options = signal<Options>(kept());

options.on((value) => localStorage.setItem(KEPT_AS, JSON.stringify(value)));

export const setOption = <K extends keyof Options>(name: K, value: Options[K]) =>
  options.update((o) => ({ ...o, [name]: value }));

export const say = (text: string) => status.set({ text, bad: false });
export const complain = (error: unknown) =>
  status.set({ text: error instanceof Error ? error.message : String(error), bad: true });

/** Number of the frame that is shown. */
export const frameNumber = () => row.get() + (take.get()?.first_frame ?? 0);

/** Trajectories that have samples. */
export const present = () => (take.get()?.trajectories ?? []).filter((t) => t.samples > 0);

const PATIENCE_MS = 250;
let wanted: number | null = null;

/** Go to a frame that is pointed at again and again: the next one only when the last one was drawn, so that it is seen. */
export function scrubTo(target: number): void {
  const idle = wanted === null;
  wanted = target;
  if (idle) follow(0);
}

function follow(since: number): void {
  const there = drawnRow.get() === row.get() || (drawnRow.get() === null && frames.get()?.get(row.get()) !== null);
  const late = performance.now() - since > PATIENCE_MS;
  if (wanted !== null && (there || late)) {
    if (wanted === row.get()) {
      wanted = null;
      return;
    }
    goTo(wanted);
    since = performance.now();
  }
  afterDrawing(() => follow(since));
}

export function goTo(target: number): void {
  const total = take.get()?.frames ?? 0;
  row.set(Math.min(Math.max(Math.round(target), 0), Math.max(total - 1, 0)));
}
