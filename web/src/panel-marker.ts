// The panel of what is selected: where it is, why it is missing, its name, and what can be done with it.

import { api, readOnly } from "./api";
import { KINDS } from "./chunk";
import { button, fill, h, select } from "./dom";
import * as mend from "./mend";
import { chosen, main } from "./selection";
import * as state from "./state";
import { after } from "./store";
import type { Preview, Suggestion } from "./wire";

const SMOOTHERS = { butterworth: "Butterworth", average: "average", gcv: "GCV spline", kalman: "Kalman" };

export class MarkerPanel {
  private readonly list = h("div", { className: "markers", role: "listbox", "aria-label": "Trajectories" });
  private readonly filter = h("input", { type: "search", placeholder: "find a marker", "aria-label": "Find a marker" });
  private readonly about = h("section", { "aria-label": "Selected marker" });
  private readonly coordinates = h("output", { id: "coordinates", className: "coordinates" });
  private readonly reasons = h("div", { id: "why", className: "why" });
  private readonly tools = h("div");
  private suggestions: Suggestion[] = [];
  private previews: Preview[] = [];
  private typed = "";
  private asked = 0;

  constructor(host: HTMLElement) {
    this.filter.oninput = () => this.drawList();
    host.append(this.about, this.filter, this.list);
    after([state.take, state.selection], () => {
      this.suggestions = [];
      this.previews = [];
      state.preview.set(null);
      this.drawList();
      this.drawTools();
    });
    after([state.range], () => {
      if (this.previews.length > 0) this.previews = [];
      state.preview.set(null);
      this.drawTools();
    });
    after([state.row, state.selection, state.loaded], () => this.drawPlace());
    let wait = 0;
    after([state.row, state.selection, state.take], () => {
      clearTimeout(wait);
      wait = setTimeout(() => this.askWhy(), state.playing.get() ? 400 : 60);
    });
    this.about.append(this.coordinates, this.reasons, this.tools);
  }

  private drawList(): void {
    const wanted = this.filter.value.toLowerCase();
    const selected = state.selection.get();
    const total = state.take.get()?.frames ?? 1;
    const rows = state
      .present()
      .filter((t) => t.name.toLowerCase().includes(wanted))
      .map((t) => {
        const share = (100 * t.samples) / total;
        return h(
          "button",
          {
            type: "button",
            role: "option",
            "aria-selected": selected.includes(t.slot),
            className: "marker",
            onclick: (e: MouseEvent) =>
              state.selection.update((s) => chosen(s, t.slot, e.shiftKey || e.ctrlKey || e.metaKey)),
          },
          h("span", {}, t.name),
          h("span", { className: "share" }, `${share.toFixed(share < 99.95 ? 1 : 0)} %`),
        );
      });
    fill(this.list, ...rows);
  }

  /** Place and kind of the selected marker in this frame. */
  private drawPlace(): void {
    const slot = main(state.selection.get());
    const frame = state.frames.get()?.peek(state.row.get());
    const take = state.take.get();
    if (take === null || slot === null) {
      fill(this.coordinates, "Click a marker to select it; with Shift, a second one.");
      return;
    }
    const name = take.trajectories[slot]?.name ?? "";
    if (!frame) return;
    const [x, y, z] = frame.xyz.subarray(3 * slot, 3 * slot + 3);
    const lines: (Node | string)[] = [h("h2", {}, name)];
    if (Number.isNaN(x)) {
      lines.push("no sample in this frame");
    } else {
      const axis = (n: string, v: number) => h("span", {}, h("b", {}, n), ` ${v.toFixed(2)}`);
      lines.push(h("div", { className: "xyz" }, axis("x", x), axis("y", y), axis("z", z), " mm"));
      const sigma = frame.sigma?.[slot];
      const residual = frame.residual?.[slot];
      const parts: string[] = [KINDS[frame.kind?.[slot] ?? 0] ?? ""];
      if (sigma !== undefined && Number.isFinite(sigma)) parts.push(`± ${sigma.toFixed(2)} mm`);
      if (residual !== undefined && Number.isFinite(residual))
        parts.push(`residual ${residual.toFixed(2)} ${take.residual_unit}`);
      lines.push(h("div", {}, parts.join(", ")));
    }
    fill(this.coordinates, ...lines);
  }

  private async askWhy(): Promise<void> {
    const [slot, take] = [main(state.selection.get()), state.take.get()];
    if (slot === null || take === null) {
      state.why.set(null);
      fill(this.reasons);
      return;
    }
    const turn = ++this.asked;
    try {
      const why = await api.why(take.name, slot, state.frameNumber());
      if (turn !== this.asked) return;
      state.why.set(why);
      const lines = why.lines.map((line) => h("li", {}, line));
      const details = h(
        "details",
        { open: openDetails },
        h("summary", {}, "What the cameras had"),
        h("ul", {}, ...lines),
      );
      details.ontoggle = () => {
        openDetails = details.open;
      };
      fill(this.reasons, h("p", {}, why.text), lines.length > 0 && details);
    } catch (error) {
      if (state.online.get()) state.complain(error);
    }
  }

  private drawTools(): void {
    const [slot, take] = [main(state.selection.get()), state.take.get()];
    if (slot === null || take === null || readOnly || slot >= take.trajectories.length) {
      fill(this.tools);
      return;
    }
    const pair = state.selection.get().length === 2;
    fill(
      this.tools,
      this.rangeLine(),
      h("h3", {}, "Name"),
      this.naming(),
      h("h3", {}, "Trajectory"),
      h(
        "div",
        { className: "buttons" },
        button("Exchange two", mend.swap, { title: "S: the selected frames of two markers", disabled: !pair }),
        button("Join two", mend.join, { title: "J", disabled: !pair }),
        button("Cut here", mend.split, { title: "X: what follows becomes a trajectory of its own" }),
        button("Delete frames", mend.remove, {
          title: "Delete: the selected frames",
          disabled: state.range.get() === null,
        }),
      ),
      h("h3", {}, "Gap"),
      this.filling(slot),
      h("h3", {}, "Noise"),
      this.smoothing(),
      h("h3", {}, "Place of this sample"),
      this.moving(),
    );
  }

  /** Frames that edits are about, which can be typed, too. */
  private rangeLine(): HTMLElement {
    const take = state.take.get()!;
    const range = state.range.get();
    const field = (id: "first" | "last", value: number | null) =>
      h("input", {
        type: "number",
        id: `range-${id}`,
        value: value === null ? "" : String(value),
        placeholder: id === "first" ? String(take.first_frame) : String(take.first_frame + take.frames - 1),
        "aria-label": `${id === "first" ? "First" : "Last"} selected frame`,
        onchange: (e: Event) => this.typeRange(id, (e.target as HTMLInputElement).value),
      });
    return h(
      "div",
      { className: "line" },
      h("span", {}, "Frames"),
      field("first", range && range.first + take.first_frame),
      "–",
      field("last", range && range.last + take.first_frame),
      button("all", () => state.range.set(null), { title: "\\", disabled: range === null }),
    );
  }

  private typeRange(end: "first" | "last", text: string): void {
    const take = state.take.get()!;
    const all = { first: 0, last: take.frames - 1 };
    const value = Math.min(Math.max(Number(text) - take.first_frame, 0), take.frames - 1);
    const range = { ...(state.range.get() ?? all), [end]: text === "" ? all[end] : value };
    state.range.set(range.first <= range.last ? range : { first: value, last: value });
  }

  private naming(): HTMLElement {
    const take = state.take.get()!;
    const field = h("input", {
      id: "name",
      list: "names",
      value: this.typed,
      placeholder: "name",
      "aria-label": "Name of the marker",
      oninput: () => {
        this.typed = field.value;
      },
      onkeydown: (e: KeyboardEvent) => {
        if (e.key === "Enter") void this.name(field.value);
      },
    });
    const names = h("datalist", { id: "names" }, ...take.suggested_names.map((n) => h("option", { value: n })));
    const likely = this.suggestions.map((s) =>
      button(`${s.name} (${s.off_mm.toFixed(1)} mm)`, () => this.name(s.name), {
        title: "distances to neighbours are so far off",
      }),
    );
    return h(
      "div",
      {},
      h(
        "div",
        { className: "line" },
        field,
        names,
        button("Name", () => this.name(field.value)),
        button("Unname", mend.unlabel, { title: "U" }),
      ),
      h(
        "div",
        { className: "buttons" },
        button("Suggest", () => this.suggest(), { title: "names that fit by their distances" }),
        ...likely,
      ),
    );
  }

  private async name(name: string): Promise<void> {
    if (!name.trim()) return state.say("Type a name first.");
    this.typed = "";
    await mend.label(name.trim());
  }

  private async suggest(): Promise<void> {
    const [slot, take] = [main(state.selection.get())!, state.take.get()!];
    try {
      this.suggestions = await api.suggestions(take.name, slot);
      if (this.suggestions.length === 0) state.say("No name is free here that its distances would fit.");
      this.drawTools();
    } catch (error) {
      state.complain(error);
    }
  }

  private filling(slot: number): HTMLElement {
    const ways = this.previews.map((p) =>
      h(
        "div",
        { className: "way" },
        h(
          "button",
          {
            type: "button",
            disabled: p.reason !== "",
            "aria-pressed": state.preview.get()?.method === p.method,
            onclick: () => {
              state.preview.set(p);
              this.drawTools();
            },
          },
          p.method,
        ),
        h("span", {}, p.reason || (p.expected_mm ? `± ${p.expected_mm.toFixed(2)} mm` : "")),
        p.reason === "" && button("Fill", () => mend.fillGap(p.method), { "aria-label": `Fill with ${p.method}` }),
      ),
    );
    return h(
      "div",
      {},
      h(
        "div",
        { className: "buttons" },
        button("Fill", () => mend.fillGap("auto"), {
          title: "I: by the mix of methods that fills others like it best",
          id: "fill",
        }),
        button("Compare methods", () => this.compare(slot)),
      ),
      ...ways,
    );
  }

  private async compare(slot: number): Promise<void> {
    const rows = mend.fillRange(slot);
    if (rows === null) return state.say("There is no gap here: go to one with G, or select frames.");
    try {
      this.previews = await api.previews(state.take.get()!.name, slot, rows.first, rows.last);
      state.preview.set(this.previews.find((p) => p.reason === "") ?? null);
      this.drawTools();
    } catch (error) {
      state.complain(error);
    }
  }

  private smoothing(): HTMLElement {
    const method = select("Filter", SMOOTHERS, "butterworth", () => {});
    const cutoff = h("input", {
      type: "number",
      value: "6",
      min: "0.1",
      step: "0.5",
      "aria-label": "Cut-off frequency in Hz",
    });
    return h(
      "div",
      { className: "line" },
      method,
      cutoff,
      "Hz",
      button("Smooth", () => mend.smooth(method.value, Number(cutoff.value))),
    );
  }

  private moving(): HTMLElement {
    const fields = ["x", "y", "z"].map((axis) =>
      h("input", { type: "number", step: "0.1", placeholder: axis, "aria-label": `${axis} in mm` }),
    );
    return h(
      "div",
      { className: "line" },
      ...fields,
      button("Move", () => {
        if (fields.some((f) => f.value === "")) return state.say("Type x, y and z in millimetres.");
        const [x, y, z] = fields.map((f) => Number(f.value));
        void mend.move([x, y, z]);
      }),
    );
  }
}

let openDetails = false;
