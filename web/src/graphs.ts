// Graphs of what is selected over the frames that the timeline shows; a click goes to that frame.

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { api } from "./api";
import { h } from "./dom";
import { main } from "./selection";
import { drawn, withPreview } from "./series";
import * as state from "./state";
import { after } from "./store";
import { css } from "./theme";
import type { Series } from "./wire";

const WHAT: Record<string, { names: string[]; unit: string }> = {
  position: { names: ["x", "y", "z"], unit: "mm" },
  velocity: { names: ["speed"], unit: "m/s" },
  residual: { names: ["residual"], unit: "" },
  uncertainty: { names: ["sigma"], unit: "mm" },
};
const COLORS = ["#d55e00", "#1aa67d", "#3d8fd1"];

export class GraphView {
  private plot: uPlot | null = null;
  private readonly playhead = h("div", { className: "playhead", hidden: true });
  private asked = 0;

  constructor(private readonly host: HTMLElement) {
    const { selection, shown, take, options, preview } = state;
    let wait = 0;
    after([selection, shown, take, options, preview], () => {
      clearTimeout(wait);
      wait = setTimeout(() => this.load(), 60);
    });
    host.append(this.playhead);
    after([state.row], () => this.movePlayhead());
    new ResizeObserver(() => this.plot?.setSize(this.size)).observe(host);
  }

  private get size() {
    return { width: this.host.clientWidth, height: Math.max(this.host.clientHeight - 56, 60) };
  }

  private async load(): Promise<void> {
    const take = state.take.get();
    const slot = main(state.selection.get());
    const what = state.options.get().graph;
    const joint = what.startsWith("joint:") ? Number(what.slice(6)) : null;
    const isJoint = joint !== null && take?.skeleton && joint < take.skeleton.joints.length;
    if (take === null || (slot === null && !isJoint)) {
      this.clear();
      return;
    }
    const turn = ++this.asked;
    const [first, last] = [Math.floor(state.shown.get().low), Math.ceil(state.shown.get().high)];
    const bins = Math.min(Math.max(this.host.clientWidth, 100), 2000);
    try {
      const series = isJoint
        ? await api.jointSeries(take.name, joint, first, last, bins)
        : await api.series(take.name, slot!, first, last, bins);
      if (turn !== this.asked) return;
      const { names, unit } = isJoint ? { names: ["x", "y", "z"], unit: "deg" } : (WHAT[what] ?? WHAT.position);
      const of = isJoint ? take.skeleton!.joints[joint] : take.trajectories[slot!].name;
      this.show(series, names, `${of} (${unit || take.residual_unit || "–"})`);
    } catch (error) {
      if (state.online.get()) state.complain(error);
    }
  }

  private clear(): void {
    this.plot?.destroy();
    this.plot = null;
    this.movePlayhead();
    this.host.dataset.empty = "Select a marker to see its graphs.";
  }

  private show(series: Series, names: string[], title: string): void {
    this.plot?.destroy();
    this.host.dataset.empty = "";
    const axis = {
      stroke: css("--muted"),
      grid: { stroke: css("--grid"), width: 1 },
      ticks: { stroke: css("--grid") },
    };
    const preview = names.length === 3 && "speed" in series.lows ? state.preview.get() : null;
    const data = drawn(series, names);
    const dashed = names.map((label, i) => ({
      label: `${label} (${preview?.method})`,
      stroke: COLORS[i],
      dash: [5, 4],
      spanGaps: true,
      points: { show: false },
    }));
    this.plot = new uPlot(
      {
        ...this.size,
        title,
        legend: { show: true, live: true },
        cursor: { drag: { x: false, y: false } },
        scales: { x: { time: false } },
        axes: [axis, { ...axis, size: 64 }],
        series: [
          { label: "frame", value: (_, v) => (v === null ? "–" : String(Math.floor(v))) },
          ...names.map((label, i) => ({ label, stroke: COLORS[i], width: 1.2, points: { show: false } })),
          ...(preview ? dashed : []),
        ],
        hooks: { draw: [() => this.movePlayhead()], ready: [(u) => this.listen(u)] },
      },
      (preview ? withPreview(data, preview) : data) as uPlot.AlignedData,
      this.host,
    );
  }

  private listen(plot: uPlot): void {
    plot.over.addEventListener("click", (event) => {
      state.goTo(Math.floor(plot.posToVal(event.offsetX, "x")) - (state.take.get()?.first_frame ?? 0));
    });
  }

  private movePlayhead(): void {
    const plot = this.plot;
    this.playhead.hidden = true;
    if (plot === null) return;
    const x = plot.valToPos(state.frameNumber() + 0.5, "x");
    const over = plot.over.getBoundingClientRect();
    const host = this.host.getBoundingClientRect();
    if (!(x >= 0 && x <= over.width)) return;
    this.playhead.hidden = false;
    this.playhead.style.top = `${over.top - host.top}px`;
    this.playhead.style.height = `${over.height}px`;
    this.playhead.style.transform = `translateX(${over.left - host.left + x - 1}px)`;
  }
}
