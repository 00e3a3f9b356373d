// The other panels: findings, edits, cameras, the skeleton's contacts, marker sets.

import { api } from "./api";
import { button, fill, h, select } from "./dom";
import * as mend from "./mend";
import { openTake } from "./open";
import * as state from "./state";
import { after } from "./store";
import { FINDING_COLORS, heat } from "./theme";
import type { AccuracyView, CoverageView, Finding, RefinedView } from "./wire";

const FINDINGS: Record<string, string> = {
  gap: "gap",
  residual: "high residual",
  jump: "jump",
  name: "doubtful name",
  unlabelled: "without a name",
};

export class FindingsPanel {
  private kind = "";

  constructor(private readonly host: HTMLElement) {
    after([state.findings, state.take], () => this.draw());
  }

  private draw(): void {
    const found = state.findings.get();
    if (found === null) {
      fill(this.host, h("p", {}, "Looking …"));
      return;
    }
    const kinds = { "": `everything (${found.findings.length})`, ...this.counts(found.findings) };
    const listed = found.findings.filter((f) => !this.kind || f.kind === this.kind).slice(0, 400);
    fill(
      this.host,
      select("Kind of finding", kinds, this.kind, (kind) => {
        this.kind = kind;
        this.draw();
      }),
      ...found.notes.map((n) => h("p", { className: "muted" }, n)),
      listed.length === 0 && h("p", {}, "Nothing to mend was found."),
      h("div", { className: "list" }, ...listed.map((f) => this.line(f))),
    );
  }

  private counts(findings: Finding[]): Record<string, string> {
    const of = (kind: string) => findings.filter((f) => f.kind === kind).length;
    return Object.fromEntries(Object.entries(FINDINGS).map(([kind, text]) => [kind, `${text} (${of(kind)})`]));
  }

  private line(one: Finding): HTMLElement {
    const first = state.take.get()?.first_frame ?? 0;
    const go = () => {
      state.goTo(one.first - first);
      state.selection.set([one.slot]);
      state.range.set({ first: one.first - first, last: one.last - first });
    };
    const mark = h("span", { className: "mark" });
    mark.style.background = FINDING_COLORS[one.kind];
    return h(
      "button",
      { type: "button", className: "finding", onclick: go },
      mark,
      h("span", {}, one.text),
      h("span", { className: "share" }, `${one.first} – ${one.last}`),
    );
  }
}

export class EditsPanel {
  constructor(private readonly host: HTMLElement) {
    after([state.take], () => this.draw());
  }

  private draw(): void {
    const take = state.take.get();
    if (take === null) return;
    const lines = take.edits.map((e, i) =>
      h(
        "li",
        { className: e.unfit ? "unfit" : "" },
        `${i + 1}. ${e.words}`,
        e.unfit && h("div", { className: "bad" }, `does not fit any more: ${e.unfit}`),
      ),
    );
    const name = h("input", { id: "export-name", value: take.export_name, "aria-label": "Name of the exported file" });
    fill(
      this.host,
      h(
        "div",
        { className: "buttons" },
        button("Undo", mend.undo, { id: "undo", title: "Ctrl+Z", disabled: !take.can_undo }),
        button("Do again", mend.redo, { id: "redo", title: "Ctrl+Shift+Z", disabled: !take.can_redo }),
      ),
      take.dots_pending && this.pending(take.name),
      lines.length === 0
        ? h(
            "p",
            {},
            "No edits yet. They are saved as they are made, beside the take; the take itself is never changed.",
          )
        : h("ol", { className: "edits", id: "edits" }, ...lines),
      h("h3", {}, "Export the mended take"),
      h(
        "div",
        { className: "line" },
        name,
        button("Export", () => this.export(name.value, false), { id: "export" }),
      ),
      h("p", { className: "muted" }, ".c3d, .trc, .parquet or .csv; .html: a page for somebody who only looks"),
      ...take.warnings.map((w) => h("p", { className: "warning" }, w)),
    );
  }

  private pending(name: string): HTMLElement {
    return h(
      "p",
      { className: "warning" },
      "Centroids were left out since the take was reconstructed. ",
      button("Reconstruct", () => run(name), { id: "reconstruct" }),
    );
  }

  private async export(file: string, overwrite: boolean): Promise<void> {
    const take = state.take.get()!;
    try {
      const done = await api.export(take.name, { file, overwrite });
      state.say(`${done.message} → ${done.path}`);
    } catch (error) {
      if (!overwrite && error instanceof Error && error.message.includes("is there already")) {
        if (confirm(`${file} is there already. Write over it?`)) await this.export(file, true);
        return;
      }
      state.complain(error);
    }
  }
}

/** The whole way again, with the edits: reconstruct, name, fill, solve. */
async function run(name: string): Promise<void> {
  await openTake(name, api.process).catch(state.complain);
}

export class CamerasPanel {
  private readonly map = h("div");
  private readonly tools = h("div");
  private readonly worth = h("div");
  private coverage: CoverageView[] = [];
  private of = "";

  constructor(host: HTMLElement) {
    host.append(this.tools, this.map, this.worth);
    after([state.take, state.accuracy, state.refined], () => this.drawWorth());
    after([state.take, state.camera, state.range, state.chosenDot, state.region], () => this.draw());
  }

  private draw(): void {
    const take = state.take.get();
    if (take === null) return;
    if (take.cameras.length === 0) {
      fill(
        this.tools,
        h("p", {}, "The take has no calibration: its cameras are not known. Open it with --calibration to see them."),
      );
      fill(this.map);
      return;
    }
    const camera = take.cameras[state.camera.get()] ?? take.cameras[0];
    const choices = Object.fromEntries(
      take.cameras.map((c, i) => [String(i), c.name && c.name !== c.id ? `${c.id} ${c.name}` : c.id]),
    );
    const range = mend.within();
    fill(
      this.tools,
      h(
        "div",
        { className: "line" },
        "Camera",
        select("Camera", choices, String(state.camera.get()), (v) => state.camera.set(Number(v))),
      ),
      h(
        "p",
        { className: "muted" },
        `${camera.size_px.join(" × ")} px, at ${camera.position_m.map((v) => v.toFixed(2)).join(", ")} m`,
      ),
      take.has_dots &&
        h(
          "div",
          { className: "buttons" },
          button(`Leave out over frames ${range.first}–${range.last}`, () => mend.excludeCamera(camera.id), {
            id: "exclude-camera",
          }),
          button("Leave out centroid", mend.excludeDot, { title: "E", disabled: state.chosenDot.get() === null }),
          button("Leave out region", mend.excludeRegion, {
            title: "drag with Shift in the image",
            disabled: state.region.get() === null,
          }),
          button("Reconstruct again", () => run(take.name), { disabled: !take.dots_pending }),
        ),
    );
    void this.drawCoverage(take.name, take.revision, take.has_dots);
  }

  /** What the rig is worth, and where its cameras would stand if they were adjusted to the take. */
  private drawWorth(): void {
    const take = state.take.get();
    if (take === null || take.cameras.length === 0) return fill(this.worth);
    const [accuracy, refined] = [state.accuracy.get(), state.refined.get()];
    fill(
      this.worth,
      h("h3", {}, "Expected accuracy in the volume"),
      accuracy === null
        ? button("Show the map", () => this.askAccuracy(take.name), { id: "show-accuracy" })
        : this.layers(accuracy.map, accuracy.layer),
      take.has_dots && h("h3", {}, "Cameras adjusted to this take"),
      take.has_dots &&
        (refined === null
          ? button("Compare", () => this.askRefined(take.name), { id: "show-refined" })
          : this.comparison(refined)),
    );
  }

  private askAccuracy(name: string): void {
    state.say("The map is being computed …");
    api.accuracy(name).then((map) => {
      state.accuracy.set({ map, layer: Math.floor(map.z_m.length / 2) });
      state.say(`Expected error where three cameras see a marker: ${map.median_mm.toFixed(3)} mm (median)`);
    }, state.complain);
  }

  private layers(map: AccuracyView, layer: number): HTMLElement {
    const height = h("input", {
      type: "range",
      min: "0",
      max: String(map.z_m.length - 1),
      value: String(layer),
      "aria-label": "Height of the layer",
      oninput: () => state.accuracy.set({ map, layer: Number(height.value) }),
    });
    return h(
      "div",
      {},
      h(
        "div",
        { className: "line" },
        `${map.z_m[layer].toFixed(2)} m`,
        height,
        button("Hide", () => state.accuracy.set(null)),
      ),
      h(
        "p",
        { className: "muted" },
        `Dark: good. ${map.median_mm.toFixed(3)} mm (median), for dots with ${map.noise_px.toFixed(2)} px of noise.`,
      ),
    );
  }

  private askRefined(name: string): void {
    state.say("The cameras are being adjusted …");
    api.refined(name).then((refined) => {
      state.refined.set(refined);
      state.say(`Residual on frames left out: ${refined.before_px.toFixed(3)} → ${refined.after_px.toFixed(3)} px`);
    }, state.complain);
  }

  private comparison(refined: RefinedView): HTMLElement {
    const rows = Object.entries(refined.moved_mm).map(([camera, moved]) =>
      h(
        "tr",
        {},
        h("td", {}, camera),
        h("td", {}, moved.toFixed(2)),
        h("td", {}, (refined.turned_deg[camera] ?? 0).toFixed(3)),
      ),
    );
    return h(
      "div",
      {},
      h(
        "p",
        {},
        `Residual on frames left out: ${refined.before_px.toFixed(3)} → ${refined.after_px.toFixed(3)} px rms (${refined.verdict}).`,
      ),
      ...refined.reasons.map((r) => h("p", { className: "warning" }, r)),
      h("table", {}, h("tr", {}, h("th", {}, "camera"), h("th", {}, "moved mm"), h("th", {}, "turned °")), ...rows),
      h("p", { className: "muted" }, "Nothing was written: `markerloom calibrate refine` writes the adjusted cameras."),
      button("Hide", () => state.refined.set(null)),
    );
  }

  /** Where in its image each camera saw something over the whole take. */
  private async drawCoverage(name: string, revision: number, hasDots: boolean): Promise<void> {
    const key = `${name} ${revision}`;
    if (!hasDots) return fill(this.map);
    if (this.of !== key) {
      this.of = key;
      this.coverage = await api.coverage(name).catch(() => []);
    }
    const pictures = this.coverage.map((c, i) => {
      const most = Math.max(...c.counts, 1);
      const canvas = h("canvas", { width: c.columns * 7, height: c.rows * 7 });
      const context = canvas.getContext("2d")!;
      c.counts.forEach((n, k) => {
        context.fillStyle = n === 0 ? "#11161c" : heat(Math.log1p(n) / Math.log1p(most));
        context.fillRect((k % c.columns) * 7, Math.floor(k / c.columns) * 7, 7, 7);
      });
      const used = c.dots ? (100 * c.used) / c.dots : 0;
      return h(
        "button",
        {
          type: "button",
          className: "coverage",
          "aria-pressed": i === state.camera.get(),
          onclick: () => state.camera.set(i),
        },
        canvas,
        h(
          "span",
          {},
          `${c.camera}: ${c.dots} centroids, ${used.toFixed(0)} % used`,
          c.residual_px ? `, ${c.residual_px.toFixed(2)} px` : "",
        ),
      );
    });
    fill(this.map, h("h3", {}, "Coverage of the images"), h("div", { className: "grid" }, ...pictures));
  }
}

export class SkeletonPanel {
  constructor(private readonly host: HTMLElement) {
    after([state.take, state.range], () => this.draw());
  }

  private draw(): void {
    const take = state.take.get();
    if (take === null) return;
    const skeleton = take.skeleton;
    if (skeleton === null || skeleton === undefined) {
      const how = take.can_solve
        ? h(
            "div",
            {},
            h("p", {}, "The skeleton was not solved yet."),
            button("Solve", () => run(take.name), { id: "solve" }),
          )
        : h("p", {}, 'A project solves skeletons where its markerloom.toml says so: skeleton = "hanim-loa1".');
      fill(this.host, how);
      return;
    }
    const range = mend.within();
    const site = skeleton.feet.length
      ? select("Place of a foot", Object.fromEntries(skeleton.feet.map((s) => [s, s])), skeleton.feet[0], () => {})
      : null;
    const contacts = take.contacts.map((c) =>
      h(
        "button",
        {
          type: "button",
          className: "finding",
          onclick: () => {
            state.range.set({ first: c.first - take.first_frame, last: c.last - take.first_frame });
            state.goTo(c.first - take.first_frame);
          },
        },
        h("span", {}, `${c.site} stands`),
        h("span", { className: "share" }, `${c.first} – ${c.last}`),
      ),
    );
    fill(
      this.host,
      h("p", {}, `${skeleton.joints.length} joints`),
      skeleton.stale &&
        h(
          "p",
          { className: "warning" },
          "The take was edited since the skeleton was solved. ",
          button("Solve again", () => run(take.name), { id: "solve" }),
        ),
      h("h3", {}, `Contacts: frames ${range.first}–${range.last}`),
      site !== null &&
        h(
          "div",
          { className: "line" },
          site,
          button("stands", () => mend.markContact(site.value, true)),
          button("does not", () => mend.markContact(site.value, false)),
        ),
      h("div", { className: "list" }, ...contacts),
    );
  }
}
