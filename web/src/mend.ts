// Mending: what the buttons and keys do. The server applies every edit, by the functions of the command line.

import { api, type Edit, ServerError } from "./api";
import { refresh } from "./open";
import { gapAt } from "./runs";
import { main, other } from "./selection";
import * as state from "./state";
import type { At, Done, Range } from "./wire";

const WAITING = "markerloom.waiting";

interface Waiting {
  take: string;
  edit: Wanted;
}

type Pointer = At | { frame: number; slot: number };
type Pointing<T> = T extends unknown ? { [K in keyof T]: T[K] extends At ? Pointer : T[K] } : never;
type Wanted = Pointing<Edit>;

/** Make an edit. Where the server is gone it waits in the browser until the server is back. */
export async function edit(wanted: Wanted): Promise<boolean> {
  const take = state.take.get();
  if (take === null) return false;
  try {
    const done = await changing(async () => api.edit(take.name, take.revision, await resolved(take.name, wanted)));
    state.say(done.message);
    return true;
  } catch (error) {
    if (error instanceof ServerError && error.kind === "offline") {
      const waiting: Waiting = { take: take.name, edit: wanted };
      localStorage.setItem(WAITING, JSON.stringify(waiting));
      state.complain(new Error("The server does not answer. Your edit is kept, and made when it is back."));
      return false;
    }
    await complained(error);
    return false;
  }
}

/** Something that changes the take, which is then shown as it is. */
async function changing(change: () => Promise<Done>): Promise<Done> {
  state.busy.update((n) => n + 1);
  try {
    const done = await change();
    await refresh(state.take.get()!.name);
    return done;
  } finally {
    state.busy.update((n) => n - 1);
  }
}

/** An error in words; where another window changed the take, it is shown as it is now. */
async function complained(error: unknown): Promise<void> {
  const take = state.take.get();
  if (error instanceof ServerError && error.kind === "conflict" && take !== null) await refresh(take.name);
  state.complain(error);
}

/** The edit that waits for the server, made now that it is back. */
export async function retryWaiting(): Promise<void> {
  const kept = localStorage.getItem(WAITING);
  const take = state.take.get();
  if (kept === null || take === null) return;
  const waiting: Waiting = JSON.parse(kept);
  if (waiting.take !== take.name) return;
  localStorage.removeItem(WAITING);
  await edit(waiting.edit);
}

async function step(how: typeof api.undo): Promise<void> {
  const take = state.take.get();
  if (take === null) return;
  try {
    const done = await changing(() => how(take.name, take.revision));
    state.say(done.message);
  } catch (error) {
    await complained(error);
  }
}

export const undo = () => step(api.undo);
export const redo = () => step(api.redo);

/** A trajectory by its sample in this frame; where that is not at hand, by its slot, which the server looks up later. */
function point(slot: number): Pointer {
  const frame = state.frameNumber();
  const xyz = state.frames
    .get()
    ?.peek(state.row.get())
    ?.xyz.subarray(3 * slot, 3 * slot + 3);
  if (xyz?.length === 3 && Number.isFinite(xyz[0])) return { frame, xyz_mm: [xyz[0], xyz[1], xyz[2]] };
  return { frame, slot };
}

/** An edit with places for all that it points at. */
async function resolved(take: string, wanted: Wanted): Promise<Edit> {
  const made: Record<string, unknown> = { ...wanted };
  for (const field of ["at", "other"]) {
    const pointer = made[field] as Pointer | undefined;
    if (pointer && "slot" in pointer) made[field] = await api.at(take, pointer.slot, pointer.frame);
  }
  return made as unknown as Edit;
}

/** The selected frames, as numbers; all of the take where none are selected. */
export function within(): Range {
  const take = state.take.get()!;
  const range = state.range.get() ?? { first: 0, last: take.frames - 1 };
  return { first: range.first + take.first_frame, last: range.last + take.first_frame };
}

const rangeOrNull = (): Range | null => (state.range.get() === null ? null : within());

/** What needs the selected marker. */
function withMain(work: (slot: number, at: Pointer) => Promise<unknown> | undefined): () => Promise<void> {
  return async () => {
    const slot = main(state.selection.get());
    if (slot === null || state.take.get() === null) return state.say("Select a marker first: click it.");
    await work(slot, point(slot));
  };
}

/** What needs two selected markers. */
function withPair(work: (at: Pointer, second: Pointer) => Promise<unknown>): () => Promise<void> {
  return async () => {
    const [a, b] = [main(state.selection.get()), other(state.selection.get())];
    if (a === null || b === null) return state.say("Select two markers first: click one, then the other with Shift.");
    await work(point(a), point(b));
  };
}

export const label = (name: string) => withMain((_, at) => edit({ op: "label", at, name, within: rangeOrNull() }))();
export const unlabel = withMain((_, at) => edit({ op: "unlabel", at, within: rangeOrNull() }));
export const swap = withPair((at, second) => edit({ op: "swap", at, other: second, within: within() }));
export const join = withPair((at, second) => edit({ op: "join", at: second, other: at }));
export const split = withMain((_, at) => edit({ op: "split", at, frame: state.frameNumber() }));
export const move = (xyz_mm: [number, number, number]) => withMain((_, at) => edit({ op: "move", at, xyz_mm }))();

export const remove = withMain((_, at) => {
  if (state.range.get() === null)
    return void state.say("Select frames first: drag over them in the timeline, or use [ and ].");
  return edit({ op: "delete", at, within: within() });
});

export const smooth = (method: string, cutoff_hz: number) =>
  withMain((_, at) => edit({ op: "smooth", at, within: within(), method, cutoff_hz }))();

/** The frames in which a gap is filled: those selected, or the gap that is looked at. */
export function fillRange(slot: number): { first: number; last: number } | null {
  return state.range.get() ?? gapAt(state.runs.get()[slot] ?? [], state.row.get());
}

export const fillGap = (method: string) =>
  withMain((slot, at) => {
    const rows = fillRange(slot);
    const take = state.take.get()!;
    if (rows === null) return void state.say("There is no gap here: go to one with G, or select frames.");
    const frames = { first: rows.first + take.first_frame, last: rows.last + take.first_frame };
    return edit({ op: "fill", at, within: frames, method, predicted: false });
  })();

export function excludeCamera(camera: string): Promise<boolean> {
  return edit({ op: "exclude_camera", camera, within: within() });
}

export async function excludeDot(): Promise<void> {
  const dot = state.chosenDot.get();
  if (dot === null) return state.say("Select a centroid in the camera's image first.");
  await edit({ op: "exclude_dot", camera: dot.camera, frame: dot.frame, pixel: [dot.x, dot.y] });
}

export async function excludeRegion(): Promise<void> {
  const region = state.region.get();
  if (region === null) return state.say("Mark a region first: drag with Shift in the camera's image.");
  if (await edit({ op: "exclude_region", ...region, within: within() })) state.region.set(null);
}

export function markContact(site: string, stands: boolean): Promise<boolean> {
  return edit({ op: "contact", site, within: within(), stands });
}
