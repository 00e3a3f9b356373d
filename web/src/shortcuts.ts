// Keys, as in the commercial tools where those agree.

import { written } from "./keys";
import * as mend from "./mend";
import { nextGap } from "./runs";
import { neighbour } from "./selection";
import * as state from "./state";

interface Shortcut {
  keys: string;
  what: string;
  run: () => unknown;
}

const step = (by: number) => () => {
  state.playing.set(false);
  state.goTo(state.row.get() + by);
};

/** To the next gap, of the selected marker where one is selected. */
export function toGap(forward: boolean): void {
  const take = state.take.get();
  if (take === null) return;
  const selected = state.selection.get();
  const named = state.present().filter((t) => t.label);
  const slots = selected.length > 0 ? selected : (named.length > 0 ? named : state.present()).map((t) => t.slot);
  const gap = nextGap(state.runs.get(), slots, state.row.get(), forward);
  if (gap === null) return state.say(`There is no gap ${forward ? "after" : "before"} this frame.`);
  state.playing.set(false);
  state.goTo(gap.first);
  state.selection.set([gap.slot]);
  state.range.set({ first: gap.first, last: gap.last });
}

/** To the next thing that is worth a look. */
export function toFinding(forward: boolean): void {
  const found = (state.findings.get()?.findings ?? []).filter((f) => f.kind !== "gap");
  const here = state.frameNumber();
  const next = forward ? found.find((f) => f.first > here) : found.findLast((f) => f.first < here);
  if (next === undefined) return state.say(`Nothing suspicious ${forward ? "after" : "before"} this frame.`);
  const first = state.take.get()!.first_frame;
  state.playing.set(false);
  state.goTo(next.first - first);
  state.selection.set([next.slot]);
  state.range.set({ first: next.first - first, last: next.last - first });
  state.say(next.text);
}

function mark(end: "first" | "last"): void {
  const row = state.row.get();
  const range = state.range.get() ?? { first: row, last: row };
  const next = { ...range, [end]: row };
  state.range.set(next.first <= next.last ? next : { first: row, last: row });
}

function toMarker(by: number): void {
  state.selection.set(
    neighbour(
      state.selection.get(),
      state.present().map((t) => t.slot),
      by,
    ),
  );
}

const focus = (id: string) => () => {
  document.getElementById("tab-marker")?.click();
  const field = document.getElementById(id) as HTMLInputElement | null;
  field?.focus();
  field?.select?.();
};

export const SHORTCUTS: Record<string, Shortcut[]> = {
  Time: [
    { keys: "Space", what: "play or stop", run: () => state.playing.update((on) => !on) },
    { keys: "ArrowRight", what: "one frame on", run: step(1) },
    { keys: "ArrowLeft", what: "one frame back", run: step(-1) },
    { keys: "Shift+ArrowRight", what: "ten frames on", run: step(10) },
    { keys: "Shift+ArrowLeft", what: "ten frames back", run: step(-10) },
    { keys: "Home", what: "to the first frame", run: step(-Infinity) },
    { keys: "End", what: "to the last frame", run: step(Number.MAX_SAFE_INTEGER) },
    { keys: "[", what: "selected frames begin here", run: () => mark("first") },
    { keys: "]", what: "selected frames end here", run: () => mark("last") },
    { keys: "\\", what: "select no frames", run: () => state.range.set(null) },
  ],
  "What to look at": [
    { keys: "g", what: "next gap", run: () => toGap(true) },
    { keys: "Shift+G", what: "gap before", run: () => toGap(false) },
    { keys: "n", what: "next suspicious place", run: () => toFinding(true) },
    { keys: "Shift+N", what: "suspicious place before", run: () => toFinding(false) },
    { keys: "ArrowDown", what: "next marker", run: () => toMarker(1) },
    { keys: "ArrowUp", what: "marker before", run: () => toMarker(-1) },
    { keys: "Escape", what: "select nothing", run: () => state.selection.set([]) },
  ],
  Mending: [
    { keys: "q", what: "name the marker", run: focus("name") },
    { keys: "u", what: "take its name", run: () => mend.unlabel() },
    { keys: "s", what: "exchange two markers over the selected frames", run: () => mend.swap() },
    { keys: "x", what: "cut the trajectory here", run: () => mend.split() },
    { keys: "j", what: "join two trajectories", run: () => mend.join() },
    { keys: "i", what: "fill the gap", run: () => mend.fillGap("auto") },
    { keys: "Delete", what: "delete the selected frames", run: () => mend.remove() },
    { keys: "e", what: "leave out the selected centroid", run: () => mend.excludeDot() },
    { keys: "Ctrl+z", what: "undo", run: () => mend.undo() },
    { keys: "Ctrl+Shift+Z", what: "do again", run: () => mend.redo() },
  ],
  View: [
    { keys: "f", what: "fit everything into the view", run: () => document.getElementById("fit")?.click() },
    { keys: "t", what: "go along with the markers", run: () => toggle("follow") },
    { keys: "l", what: "names of all markers", run: () => toggle("names") },
    { keys: "1", what: "3D", run: () => state.setOption("view", "3d") },
    { keys: "2", what: "camera image", run: () => state.setOption("view", "2d") },
    { keys: "3", what: "both", run: () => state.setOption("view", "both") },
    { keys: "?", what: "this list", run: () => (document.getElementById("help") as HTMLDialogElement).showModal() },
  ],
};

function toggle(name: "follow" | "names"): void {
  state.setOption(name, !state.options.get()[name]);
}

const TYPED = new Set(["INPUT", "SELECT", "TEXTAREA"]);

export function listenToKeys(): void {
  const byKeys = new Map(
    Object.values(SHORTCUTS)
      .flat()
      .map((s) => [s.keys, s]),
  );
  addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    if (TYPED.has(target.tagName) || document.querySelector("dialog[open]") !== null) return;
    // A focused button keeps Space and Enter for itself.
    if (target.tagName === "BUTTON" && (event.key === " " || event.key === "Enter")) return;
    const shortcut = byKeys.get(written(event));
    if (shortcut === undefined) return;
    event.preventDefault();
    shortcut.run();
  });
}
