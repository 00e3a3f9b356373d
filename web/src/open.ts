// Opening a take, and looking at it again after it was changed.

import { api } from "./api";
import { FrameStore } from "./frames";
import { remaining } from "./selection";
import * as state from "./state";
import type { TakeInfo, TakeView } from "./wire";

const ASKED_EVERY_MS = 150;
const pause = (ms: number) => new Promise((done) => setTimeout(done, ms));

/** Open a take and wait until it is there. */
export async function openTake(name: string, how: (take: string) => Promise<TakeInfo> = api.open): Promise<void> {
  state.playing.set(false);
  state.busy.update((n) => n + 1);
  try {
    await opened(name, how);
  } finally {
    state.busy.update((n) => n - 1);
  }
}

async function opened(name: string, how: (take: string) => Promise<TakeInfo>): Promise<void> {
  let info = await how(name);
  for (; info.state === "working"; info = await api.open(name)) {
    state.say(`${info.message} …`);
    await pause(ASKED_EVERY_MS);
  }
  if (info.state === "failed") throw new Error(info.message);
  const fresh = state.take.get()?.name !== name;
  if (fresh) {
    state.accuracy.set(null);
    state.refined.set(null);
    state.selection.set([]);
    state.range.set(null);
    state.row.set(0);
  }
  await refresh(name);
  const take = state.take.get()!;
  if (fresh) state.shown.set({ low: 0, high: Math.max(take.frames, 1) });
  if (info.message) state.complain(new Error(info.message));
  else state.say(`${name}: ${take.frames} frames, ${take.trajectories.length} trajectories`);
}

/** Fetch what is known of a take as it is now. */
export async function refresh(name: string): Promise<void> {
  const [take, timeline] = await Promise.all([api.take(name), api.timeline(name)]);
  const there = new Set(take.trajectories.filter((t) => t.samples > 0).map((t) => t.slot));
  state.runs.set(timeline.runs);
  state.frames.set(store(take, take.chunk_frames, api.chunk));
  state.joints.set(take.skeleton ? store(take, 256, api.joints) : null);
  state.take.set(take);
  state.selection.update((s) => remaining(s, there));
  state.preview.set(null);
  state.goTo(state.row.get());
  state.loaded.update((n) => n + 1);
  // The first frames come first.
  setTimeout(() => lookForFindings(take), 500);
  const frames = state.frames.get();
  if (take.trajectories.length > 0 && take.overview_stride > 1)
    api.overview(take.name).then(
      (b) => frames?.addOverview(take.overview_stride, b),
      () => {},
    );
}

function store(take: TakeView, size: number, load: typeof api.chunk): FrameStore {
  const arrived = () => state.loaded.update((n) => n + 1);
  const failed = (error: unknown) => state.online.get() && state.complain(error);
  return new FrameStore(size, take.frames, (first, count) => load(take.name, first, count), arrived, failed);
}

function lookForFindings(take: TakeView): void {
  api.findings(take.name).then(
    (found) => state.take.get()?.revision === found.revision && state.findings.set(found),
    () => state.findings.set(null),
  );
}
