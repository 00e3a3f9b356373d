// The timeline: a ruler, and a row for every trajectory that shows what its samples are (figure 12 of Lee et al. 2000).

import { h } from "./dom";
import { moved, showing, stretches, zoomed } from "./runs";
import { drawSoon } from "./schedule";
import { chosen } from "./selection";
import * as state from "./state";
import { after } from "./store";
import { css, FINDING_COLORS, KIND_COLORS } from "./theme";

const RULER = 24;
const MARKS = 8;
const ROW = 15;
const NAMES = 104;
/** How high each kind is drawn: told apart without colour, too. */
const HEIGHTS = [0.8, 0.34, 0.56, 0.8];

export class TimelineView {
  private readonly canvas = document.createElement("canvas");
  private readonly context = this.canvas.getContext("2d")!;
  private readonly playhead = h("div", { className: "playhead" });
  private top = 0;
  private readonly renderNow = () => this.render();

  constructor(private readonly host: HTMLElement) {
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "slider");
    this.canvas.setAttribute("aria-label", "Frame");
    host.append(this.canvas, this.playhead);
    new ResizeObserver(() => this.resize()).observe(host);
    this.canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    this.canvas.addEventListener("pointerdown", (e) => this.press(e));
    const { row, runs, selection, range, shown, findings, take, options } = state;
    // The frame moves an element of its own: what lies below is drawn only when that changes.
    after([row, shown, take], () => this.movePlayhead());
    after([runs, selection, range, shown, findings, take, options], () => this.draw());
    row.on(() => {
      const total = take.get()?.frames ?? 1;
      shown.update((w) => showing(w, row.get(), total));
      this.canvas.setAttribute("aria-valuenow", String(state.frameNumber()));
    });
    selection.on(() => this.showSelected());
  }

  private get slots(): number[] {
    return state.present().map((t) => t.slot);
  }

  private get perRow(): number {
    const { low, high } = state.shown.get();
    return (this.host.clientWidth - NAMES) / Math.max(high - low, 1e-9);
  }

  private rowAt(x: number): number {
    return Math.floor(state.shown.get().low + (x - NAMES) / this.perRow);
  }

  /** Where many frames share a pixel, one of them that is at hand at once. */
  private scrub(row: number): void {
    const stride = state.frames.get()?.stride ?? 0;
    state.scrubTo(stride > 1 && stride * this.perRow <= 1 ? Math.round(row / stride) * stride : row);
  }

  private xOf(row: number): number {
    return NAMES + (row - state.shown.get().low) * this.perRow;
  }

  private showSelected(): void {
    const at = this.slots.indexOf(state.selection.get().at(-1) ?? -1);
    const room = this.host.clientHeight - RULER - MARKS;
    if (at < 0) return;
    if (at * ROW < this.top) this.top = at * ROW;
    if ((at + 1) * ROW > this.top + room) this.top = (at + 1) * ROW - room;
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const total = state.take.get()?.frames ?? 1;
    const box = this.canvas.getBoundingClientRect();
    const x = event.clientX - box.left;
    if (event.ctrlKey || event.metaKey || x > NAMES ? event.deltaY !== 0 && !event.shiftKey : false) {
      state.shown.update((w) => zoomed(w, Math.exp(event.deltaY * 0.002), this.rowAt(x), total));
    } else if (event.shiftKey || event.deltaX !== 0) {
      state.shown.update((w) => moved(w, (event.deltaX || event.deltaY) / this.perRow, total));
    } else {
      this.scroll(event.deltaY);
    }
  }

  private scroll(by: number): void {
    const room = this.host.clientHeight - RULER - MARKS;
    this.top = Math.max(0, Math.min(this.top + by, this.slots.length * ROW - room));
    this.draw();
  }

  /** On the ruler: scrub. On a row: select its marker; a drag selects frames. On the names: select markers. */
  private press(down: PointerEvent): void {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [down.clientX - box.left, down.clientY - box.top];
    const add = down.shiftKey || down.ctrlKey || down.metaKey;
    const scrubbing = y < RULER + MARKS && x >= NAMES;
    const start = this.rowAt(x);
    const total = state.take.get()?.frames ?? 1;
    if (scrubbing) this.scrub(start);
    else this.pick(y, add);
    const move = (event: PointerEvent) => {
      const row = this.rowAt(event.clientX - box.left);
      if (scrubbing) {
        this.scrub(row);
      } else if (x >= NAMES && Math.abs(event.clientX - down.clientX) > 3) {
        const [first, last] = [Math.max(Math.min(start, row), 0), Math.min(Math.max(start, row), total - 1)];
        state.range.set({ first, last });
      }
    };
    const release = (event: PointerEvent) => {
      removeEventListener("pointermove", move);
      removeEventListener("pointerup", release);
      if (!scrubbing && x >= NAMES && Math.abs(event.clientX - down.clientX) <= 3) state.goTo(start);
    };
    addEventListener("pointermove", move);
    addEventListener("pointerup", release);
  }

  private pick(y: number, add: boolean): void {
    const slot = this.slots[Math.floor((y - RULER - MARKS + this.top) / ROW)];
    if (slot !== undefined) state.selection.update((s) => chosen(s, slot, add));
  }

  draw(): void {
    drawSoon(this.renderNow);
  }

  private render(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    const context = this.context;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.fillStyle = css("--panel");
    context.fillRect(0, 0, width, height);
    const take = state.take.get();
    if (take === null) return;
    this.canvas.setAttribute("aria-valuemin", String(take.first_frame));
    this.canvas.setAttribute("aria-valuemax", String(take.first_frame + take.frames - 1));
    this.drawRange(height);
    this.drawRows(width, height);
    this.drawRuler(width, take.first_frame);
    this.drawMarks(take.first_frame);
  }

  private movePlayhead(): void {
    const x = Math.round(this.xOf(state.row.get() + 0.5)) - 1;
    this.playhead.hidden = x < NAMES || x > this.host.clientWidth;
    this.playhead.style.transform = `translateX(${x}px)`;
  }

  private resize(): void {
    this.canvas.width = this.host.clientWidth * devicePixelRatio;
    this.canvas.height = this.host.clientHeight * devicePixelRatio;
    this.movePlayhead();
    this.draw();
  }

  private drawRange(height: number): void {
    const range = state.range.get();
    if (range === null) return;
    const x0 = Math.max(this.xOf(range.first), NAMES);
    this.context.fillStyle = css("--range");
    this.context.fillRect(x0, RULER, Math.max(this.xOf(range.last + 1) - x0, 1), height - RULER);
  }

  private drawRows(width: number, height: number): void {
    const context = this.context;
    const { low, high } = state.shown.get();
    const [every, take] = [state.runs.get(), state.take.get()!];
    const selected = new Set(state.selection.get());
    const slots = this.slots;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    const first = Math.floor(this.top / ROW);
    for (let i = first; i < slots.length; i += 1) {
      const y = RULER + MARKS + i * ROW - this.top;
      if (y > height) break;
      const slot = slots[i];
      if (selected.has(slot)) {
        context.fillStyle = css("--row");
        context.fillRect(0, y, width, ROW);
      }
      context.fillStyle = selected.has(slot) ? css("--text") : css("--muted");
      context.fillText(take.trajectories[slot].name, NAMES - 8, y + ROW / 2, NAMES - 10);
      for (const [x, long, kind] of stretches(every[slot] ?? [], low, high, width - NAMES)) {
        const tall = ROW * HEIGHTS[kind];
        context.fillStyle = KIND_COLORS[kind];
        context.fillRect(NAMES + x, y + (ROW - tall) / 2, Math.max(long, 0.6), tall);
      }
    }
    context.fillStyle = css("--panel");
    context.fillRect(0, 0, width, RULER + MARKS);
  }

  private drawRuler(width: number, firstFrame: number): void {
    const context = this.context;
    const { low, high } = state.shown.get();
    const wanted = ((high - low) * 90) / Math.max(width - NAMES, 1);
    const power = 10 ** Math.floor(Math.log10(Math.max(wanted, 1)));
    const step = Math.max(1, [1, 2, 5, 10].map((m) => m * power).find((s) => s >= wanted) ?? 10 * power);
    context.textAlign = "left";
    context.textBaseline = "middle";
    for (let f = Math.ceil((low + firstFrame) / step) * step; f < high + firstFrame; f += step) {
      const x = this.xOf(f - firstFrame + 0.5);
      context.fillStyle = css("--line");
      context.fillRect(x, RULER - 8, 1, 8);
      context.fillStyle = css("--muted");
      context.fillText(String(f), x + 3, RULER / 2);
    }
    context.fillStyle = css("--muted");
    context.textAlign = "right";
    context.fillText("frame", NAMES - 8, RULER / 2);
  }

  /** What is worth a look, of all trajectories, in one line. */
  private drawMarks(firstFrame: number): void {
    for (const one of state.findings.get()?.findings ?? []) {
      if (one.kind === "unlabelled") continue;
      const [x0, x1] = [this.xOf(one.first - firstFrame), this.xOf(one.last + 1 - firstFrame)];
      if (x1 < NAMES) continue;
      this.context.fillStyle = FINDING_COLORS[one.kind];
      this.context.fillRect(Math.max(x0, NAMES), RULER, Math.max(x1 - Math.max(x0, NAMES), 1.5), MARKS - 3);
    }
  }
}
