// Marker sets and subjects: looked at, changed, and saved into the project.

import { api } from "./api";
import { button, fill, h, select } from "./dom";
import * as state from "./state";
import type { MarkerSetView, MarkerView, SubjectEdit, SubjectView } from "./wire";

const SIDES = { left: "left", middle: "middle", right: "right" };

export class SetsPanel {
  private names: string[] = [];
  private name = "";
  private set: MarkerSetView | null = null;
  private subjects: SubjectView[] = [];

  constructor(private readonly host: HTMLElement) {}

  /** Fetched when the panel is looked at for the first time. */
  async open(): Promise<void> {
    if (this.names.length > 0) return;
    try {
      [this.names, this.subjects] = await Promise.all([api.markerSets(), api.subjects()]);
      await this.choose(this.names[0] ?? "");
    } catch (error) {
      state.complain(error);
    }
  }

  private async choose(name: string): Promise<void> {
    this.name = name;
    this.set = await api.markerSet(name);
    this.draw();
  }

  private draw(): void {
    const set = this.set;
    if (set === null) return;
    const own = this.name.endsWith(".toml") ? this.name : `${this.name}-own.toml`;
    const file = h("input", { id: "set-file", value: own, "aria-label": "File of the marker set" });
    const rows = set.markers.map((m, i) => this.row(m, i));
    fill(
      this.host,
      h(
        "div",
        { className: "line" },
        "Set",
        select(
          "Marker set",
          Object.fromEntries(this.names.map((n) => [n, n])),
          this.name,
          (n) => void this.choose(n).catch(state.complain),
        ),
      ),
      h("p", { className: "muted" }, `${set.title || set.name}: ${set.markers.length} markers`),
      h("div", { className: "set-rows" }, ...rows),
      h(
        "div",
        { className: "buttons" },
        button("Add a marker", () =>
          this.change((m) => [
            ...m,
            { name: `M${m.length + 1}`, side: "middle", segment: "", color: "#9aa5b1", place: null },
          ]),
        ),
        button("Names of the take", () => this.takeNames(), {
          title: "the names that the open take has become the set",
        }),
      ),
      h(
        "div",
        { className: "line" },
        file,
        button("Save into the project", () => this.save(file.value)),
      ),
      h("h3", {}, "Subjects"),
      this.learning(),
      ...this.subjects.map((s) => this.subject(s)),
    );
  }

  private change(how: (markers: MarkerView[]) => MarkerView[]): void {
    if (this.set === null) return;
    this.set = { ...this.set, markers: how(this.set.markers) };
    this.draw();
  }

  private row(marker: MarkerView, i: number): HTMLElement {
    const put = (part: Partial<MarkerView>) => {
      const before = this.set!;
      const markers = before.markers.map((m, k) => (k === i ? { ...m, ...part } : m));
      const renamed = part.name;
      const links = renamed
        ? before.links.map((pair) => pair.map((n) => (n === marker.name ? renamed : n)) as [string, string])
        : before.links;
      this.set = { ...before, markers, links };
    };
    const text = (field: "name" | "segment") =>
      h("input", {
        value: marker[field],
        placeholder: field,
        "aria-label": `${field} of marker ${i + 1}`,
        onchange: (e: Event) => put({ [field]: (e.target as HTMLInputElement).value }),
      });
    return h(
      "div",
      { className: "line" },
      h("input", {
        type: "color",
        value: marker.color || "#9aa5b1",
        "aria-label": `colour of ${marker.name}`,
        onchange: (e: Event) => put({ color: (e.target as HTMLInputElement).value }),
      }),
      text("name"),
      select(`side of ${marker.name}`, SIDES, marker.side, (side) => put({ side: side as MarkerView["side"] })),
      text("segment"),
      button("×", () => this.remove(i), { "aria-label": `remove ${marker.name}` }),
    );
  }

  private remove(i: number): void {
    const gone = this.set!.markers[i].name;
    this.set = { ...this.set!, links: this.set!.links.filter((pair) => !pair.includes(gone)) };
    this.change((m) => m.filter((_, k) => k !== i));
  }

  private takeNames(): void {
    const known = new Map(this.set!.markers.map((m) => [m.name, m]));
    const names = state
      .present()
      .map((t) => t.label)
      .filter(Boolean);
    if (names.length === 0) return state.say("No marker of the take has a name.");
    this.set = { ...this.set!, links: [] };
    this.change(() =>
      names.map((name) => known.get(name) ?? { name, side: "middle", segment: "", color: "#9aa5b1", place: null }),
    );
  }

  private async save(file: string): Promise<void> {
    try {
      const done = await api.saveMarkerSet(file, this.set!);
      state.say(`saved ${done.message} → ${done.path}`);
      this.names = await api.markerSets();
      await this.choose(file);
    } catch (error) {
      state.complain(error);
    }
  }

  /** Who wears the markers, learned from the take as it is now. */
  private learning(): HTMLElement {
    const name = h("input", { placeholder: "who", "aria-label": "Name of the subject" });
    return h(
      "div",
      { className: "line" },
      name,
      button("Learn from this take", () => void this.learn(name.value, false)),
    );
  }

  private async learn(name: string, overwrite: boolean): Promise<void> {
    try {
      const done = await api.learnSubject(state.take.get()!.name, { name, overwrite });
      state.say(done.message);
      this.subjects = await api.subjects();
      this.draw();
    } catch (error) {
      const there = error instanceof Error && error.message.includes("is there already");
      if (there && !overwrite) {
        if (confirm(`${name}.toml is there already. Write over it?`)) await this.learn(name, true);
        return;
      }
      state.complain(error);
    }
  }

  /** A subject: its markers can be renamed or let go, its firmest distances are shown. */
  private subject(one: SubjectView): HTMLElement {
    const names = new Map(one.markers.map((m) => [m, m]));
    const who = h("input", { value: one.name, "aria-label": `Name of subject ${one.name}` });
    const rename = (m: string) => (e: Event) => {
      names.set(m, (e.target as HTMLInputElement).value.trim());
    };
    const markers = one.markers.map((m) => {
      const field = h("input", { value: m, "aria-label": `name of ${m} of ${one.name}`, onchange: rename(m) });
      const line = h("div", { className: "line" }, field);
      const letGo = () => {
        names.delete(m);
        line.remove();
      };
      line.append(button("×", letGo, { "aria-label": `let ${m} of ${one.name} go` }));
      return line;
    });
    const rows = one.firmest.map(([a, b, mean, sd]) =>
      h("tr", {}, h("td", {}, `${a} – ${b}`), h("td", {}, mean.toFixed(1)), h("td", {}, sd.toFixed(2))),
    );
    const save = () => this.saveSubject(one.file, { name: who.value, markers: Object.fromEntries(names) });
    const title = `${one.name}: ${one.markers.length} markers, learned from ${Math.round(one.poses)} poses (${one.file})`;
    return h(
      "details",
      {},
      h("summary", {}, title),
      h(
        "div",
        { className: "line" },
        who,
        button("Save", () => void save()),
      ),
      h("div", { className: "set-rows" }, ...markers),
      h("table", {}, h("tr", {}, h("th", {}, "firmest distances"), h("th", {}, "mm"), h("th", {}, "sd")), ...rows),
    );
  }

  private async saveSubject(file: string, wanted: SubjectEdit): Promise<void> {
    try {
      const done = await api.editSubject(file, wanted);
      state.say(`saved ${done.message}`);
      this.subjects = await api.subjects();
      this.draw();
    } catch (error) {
      state.complain(error);
    }
  }
}
