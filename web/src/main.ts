// The page: puts the views together and connects them with the server.

import { api, listen, readOnly, ServerError } from "./api";
import { button, fill, h, select } from "./dom";
import { GraphView } from "./graphs";
import { ImageView } from "./image-view";
import { retryWaiting } from "./mend";
import { openTake, refresh } from "./open";
import { MarkerPanel } from "./panel-marker";
import { SetsPanel } from "./panel-sets";
import { CamerasPanel, EditsPanel, FindingsPanel, SkeletonPanel } from "./panels";
import { Player } from "./player";
import { onPick, View3D } from "./scene";
import { chosen } from "./selection";
import { listenToKeys, SHORTCUTS, toFinding, toGap } from "./shortcuts";
import * as state from "./state";
import { after } from "./store";
import "./style.css";
import { applyTheme } from "./theme";
import { TimelineView } from "./timeline";
import type { Notice, TakeView } from "./wire";

const element = (id: string) => document.getElementById(id)!;
const SPEEDS = { "0.1": "× 0.1", "0.25": "× 0.25", "0.5": "× 0.5", "1": "× 1", "2": "× 2", "4": "× 4" };
const COLORS = {
  label: "colour: name",
  kind: "colour: kind",
  residual: "colour: residual",
  confidence: "colour: uncertainty",
};
const TOGGLES = {
  names: "names",
  trails: "trail",
  path: "whole path",
  links: "links",
  skeleton: "skeleton",
  cameras: "cameras",
  rays: "rays",
  follow: "follow",
} as const;

/** The 3D view; without WebGL a message in its place, and everything else goes on. */
function start3D(): View3D | null {
  try {
    return new View3D(element("view-3d"));
  } catch {
    fill(
      element("view-3d"),
      h(
        "p",
        { className: "empty", role: "alert" },
        "This browser shows no 3D: WebGL is missing or switched off. The camera images, the timeline, the graphs and all edits work. Switch on hardware acceleration in the browser's settings, or try another browser.",
      ),
    );
    return null;
  }
}

function connectViews(view: View3D | null): void {
  const { take, row, selection, options, loaded, why, preview, joints } = state;
  let shape = "";
  take.on((t) => {
    const now = t === null ? "" : `${t.name} ${t.trajectories.length} ${t.skeleton?.joints.length} ${t.cameras.length}`;
    if (now !== shape) view?.newTake();
    shape = now;
  });
  after([take, row, selection, options, loaded, why, preview, joints], () => view?.draw());
  state.accuracy.on(() => view?.showAccuracy());
  state.refined.on(() => view?.showRefined());
  onPick((slot, add) => {
    if (slot !== null) selection.update((s) => chosen(s, slot, add));
    else if (!add) selection.set([]);
  });
}

function drawToolbar(view: View3D | null): void {
  const toggles = Object.entries(TOGGLES).map(([name, text]) => {
    const key = name as keyof typeof TOGGLES;
    const made = button(text, () => state.setOption(key, !state.options.get()[key]));
    const draw = () => made.setAttribute("aria-pressed", String(state.options.get()[key]));
    state.options.on(draw);
    draw();
    return made;
  });
  const views = (readOnly ? (["3d"] as const) : (["3d", "2d", "both"] as const)).map((v, i) => {
    const made = button(["3D", "camera", "both"][i], () => state.setOption("view", v), { title: `key ${i + 1}` });
    const draw = () => made.setAttribute("aria-pressed", String(state.options.get().view === v));
    state.options.on(draw);
    draw();
    return made;
  });
  const { colorBy, up } = state.options.get();
  fill(
    element("toolbar"),
    h("span", { className: "group", role: "group", "aria-label": "Views" }, ...views),
    h("span", { className: "group", role: "group", "aria-label": "What is shown" }, ...toggles),
    select("Colour by", COLORS, colorBy, (v) => state.setOption("colorBy", v as typeof colorBy)),
    select("Up axis", { z: "Z up", y: "Y up" }, up, (v) => state.setOption("up", v as typeof up)),
    button("fit", () => view?.fit(), { id: "fit", title: "F" }),
  );
}

function drawTransport(): void {
  const play = button("▶", () => state.playing.update((on) => !on), {
    id: "play",
    "aria-label": "Play",
    title: "Space",
  });
  state.playing.on((on) => {
    play.textContent = on ? "❚❚" : "▶";
    play.setAttribute("aria-label", on ? "Stop" : "Play");
  });
  const frame = h("input", {
    type: "number",
    id: "frame",
    "aria-label": "Frame",
    onchange: () => state.goTo(Number(frame.value) - (state.take.get()?.first_frame ?? 0)),
  });
  const time = h("output", { id: "time", className: "muted" });
  after([state.row, state.take], () => {
    const take = state.take.get();
    if (document.activeElement !== frame) frame.value = String(state.frameNumber());
    time.textContent = take
      ? `${(state.row.get() / take.rate_hz).toFixed(3)} s of ${((take.frames - 1) / take.rate_hz).toFixed(2)} s`
      : "";
  });
  const loop = button("loop", () => state.looping.update((on) => !on), { "aria-pressed": true });
  state.looping.on((on) => loop.setAttribute("aria-pressed", String(on)));
  const step = (by: number) => state.goTo(state.row.get() + by);
  fill(
    element("transport"),
    button("◀◀", () => step(-1), { "aria-label": "One frame back", title: "←" }),
    play,
    button("▶▶", () => step(1), { "aria-label": "One frame on", title: "→" }),
    frame,
    time,
    select("Speed", SPEEDS, "1", (v) => state.speed.set(Number(v))),
    loop,
    button("next gap", () => toGap(true), { title: "G", id: "next-gap" }),
    button("next suspicious", () => toFinding(true), { title: "N" }),
    h(
      "span",
      { className: "legend" },
      ...["measured", "predicted", "filled", "edited"].map((k) => h("span", { className: `kind ${k}` }, k)),
    ),
  );
}

/** What the graphs show; joints are offered where there is a skeleton. */
function drawGraphChoice(): void {
  const host = element("graph-choice");
  const draw = (take: TakeView | null) => {
    const joints = Object.fromEntries((take?.skeleton?.joints ?? []).map((j, i) => [`joint:${i}`, `angles: ${j}`]));
    const choices = {
      position: "position",
      velocity: "velocity",
      residual: "residual",
      uncertainty: "uncertainty",
      ...joints,
      none: "no graph",
    };
    fill(
      host,
      select("Graph", choices, state.options.get().graph, (v) => state.setOption("graph", v)),
    );
  };
  state.take.on(draw);
  draw(null);
}

function drawTabs(): void {
  const sets = new SetsPanel(element("panel-sets"));
  new MarkerPanel(element("panel-marker"));
  new FindingsPanel(element("panel-findings"));
  new EditsPanel(element("panel-edits"));
  new CamerasPanel(element("panel-cameras"));
  new SkeletonPanel(element("panel-skeleton"));
  const every = [...document.querySelectorAll<HTMLButtonElement>("[role=tab]")];
  // A page that holds its take shows it, and no more.
  const tabs = every.filter((tab) => !readOnly || ["tab-marker", "tab-findings"].includes(tab.id));
  for (const tab of every) tab.hidden = !tabs.includes(tab);
  const show = (wanted: HTMLButtonElement) => {
    for (const tab of tabs) {
      const on = tab === wanted;
      tab.setAttribute("aria-selected", String(on));
      tab.tabIndex = on ? 0 : -1;
      element(tab.getAttribute("aria-controls")!).hidden = !on;
    }
    if (wanted.id === "tab-sets") void sets.open();
  };
  tabs.forEach((tab, i) => {
    tab.onclick = () => show(tab);
    tab.onkeydown = (e) => {
      const by = e.key === "ArrowRight" ? 1 : e.key === "ArrowLeft" ? -1 : 0;
      if (by === 0) return;
      e.stopPropagation();
      const next = tabs[(i + by + tabs.length) % tabs.length];
      next.focus();
      show(next);
    };
  });
}

function drawHelp(): void {
  const key = (keys: string) => keys.replace("Arrow", "").replace("Ctrl", "Ctrl/⌘");
  const groups = Object.entries(SHORTCUTS).map(([title, list]) =>
    h(
      "section",
      {},
      h("h3", {}, title),
      h("dl", {}, ...list.flatMap((s) => [h("dt", {}, h("kbd", {}, key(s.keys))), h("dd", {}, s.what)])),
    ),
  );
  const dialog = element("help") as HTMLDialogElement;
  fill(
    dialog,
    h("h2", {}, "Keys"),
    h("div", { className: "keys" }, ...groups),
    button("Close", () => dialog.close()),
  );
  element("show-help").onclick = () => dialog.showModal();
}

/** One line for whoever looks, and for screen readers: what was done, what went wrong, what to do. */
function drawStatus(): void {
  const line = element("status");
  state.status.on(({ text, bad }) => {
    line.textContent = text;
    line.className = bad ? "bad" : "";
  });
  const banner = element("banner");
  after([state.online, state.sourceState], () => {
    const take = state.take.get();
    const [on, source] = [state.online.get(), state.sourceState.get()];
    banner.hidden = on && source === "ok";
    if (!on)
      fill(
        banner,
        "The server does not answer. It is tried again; what you did is saved. If it was ended, start it again with the same command.",
      );
    else if (source === "gone")
      fill(
        banner,
        `${take?.file} is gone from disk. Edits are still saved beside where it was; to export, put it back.`,
      );
    else if (source === "changed")
      fill(
        banner,
        `${take?.file} was changed on disk since it was opened. `,
        button("Open it again", () => void openTake(take!.name, api.reopen).catch(state.complain)),
      );
  });
}

function drawTakes(): void {
  after([state.project, state.take], () => {
    const project = state.project.get();
    if (project === null) return;
    document.title = `${project.name} · markerloom`;
    element("project").textContent = project.name;
    const choices = Object.fromEntries(project.takes.map((t) => [t.name, t.name]));
    const present = state.take.get()?.name ?? wantedTake() ?? project.takes[0].name;
    fill(element("takes"), project.takes.length > 1 && select("Take", choices, present, (name) => void open(name)));
  });
}

/** The take that the address names. */
const wantedTake = () => new URLSearchParams(location.search).get("take");

async function open(name: string): Promise<void> {
  try {
    element("failure").hidden = true;
    await openTake(name);
    if (!readOnly) {
      const back = new URL(location.href);
      back.searchParams.set("take", name);
      history.replaceState(null, "", back);
      await retryWaiting();
    }
  } catch (error) {
    state.complain(error);
    const text = error instanceof Error ? error.message : String(error);
    fill(
      element("failure"),
      h("h2", {}, `${name} cannot be shown`),
      h("p", {}, text),
      button("Try again", () => void openAgain(name)),
    );
    element("failure").hidden = false;
  }
}

async function openAgain(name: string): Promise<void> {
  element("failure").hidden = true;
  await openTake(name, api.reopen).catch((error) => {
    state.complain(error);
    element("failure").hidden = false;
  });
}

let instance = "";

/** What the server told: another window changed the take, the server was started anew, the file changed. */
async function told(notice: Notice): Promise<void> {
  const take = state.take.get();
  const again = instance !== "" && notice.instance !== instance;
  instance = notice.instance;
  if (take === null) return;
  if (again) {
    await open(take.name);
    return;
  }
  state.sourceState.set(notice.sources[take.name] ?? "ok");
  const now = notice.revisions[take.name];
  const busy = state.busy.get() > 0 || notice.takes.find((t) => t.name === take.name)?.state === "working";
  if (now !== undefined && now > (state.take.get()?.revision ?? now) && !busy) {
    await refresh(take.name).catch(state.complain);
    state.say("The take was changed in another window; it is shown as it is now.");
  }
}

function layout(): void {
  const draw = () => {
    const { view, graph, theme } = state.options.get();
    element("views").dataset.view = view;
    element("graphs").dataset.graph = graph;
    const used = applyTheme(theme);
    element("theme").textContent = used === "dark" ? "light" : "dark";
  };
  state.options.on(draw);
  draw();
}

async function start(): Promise<void> {
  if (readOnly) state.setOption("view", "3d");
  layout();
  const view = start3D();
  connectViews(view);
  element("theme").onclick = () => {
    state.setOption("theme", document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    view?.theme();
    state.loaded.update((n) => n + 1);
  };
  drawToolbar(view);
  drawTransport();
  drawGraphChoice();
  drawTabs();
  drawHelp();
  drawStatus();
  drawTakes();
  new TimelineView(element("timeline"));
  new ImageView(element("view-2d"));
  new GraphView(element("graphs"));
  new Player();
  listenToKeys();
  // For measurements: how many frames the 3D view has drawn.
  Object.assign(window, { markerloom: { drawn: () => view?.drawn ?? 0, state, view } });
  try {
    const project = await api.project();
    state.project.set(project);
    const first = project.takes.find((t) => t.name === wantedTake()) ?? project.takes[0];
    listen((notice) => void told(notice), state.online.set);
    await open(first.name);
  } catch (error) {
    const refused = error instanceof ServerError && error.kind === "refused";
    fill(
      element("failure"),
      h("h2", {}, refused ? "This address does not open the studio" : "The studio cannot start"),
      h("p", {}, error instanceof Error ? error.message : String(error)),
    );
    element("failure").hidden = false;
  }
}

void start();
