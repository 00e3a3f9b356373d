// Playing: the frame that is due by the clock; where it is not at hand yet, the last one stays.

import { tickSoon } from "./schedule";
import * as state from "./state";

export class Player {
  private from = 0;
  private since = 0;
  private readonly tickNow = () => this.tick();

  constructor() {
    state.playing.on((on) => on && this.start());
    state.speed.on(() => state.playing.get() && this.start());
  }

  private start(): void {
    const bounds = this.bounds();
    if (state.row.get() >= bounds.last || state.row.get() < bounds.first) state.goTo(bounds.first);
    this.from = state.row.get();
    this.since = performance.now();
    tickSoon(this.tickNow);
  }

  /** The selected frames, or the whole take. */
  private bounds(): { first: number; last: number } {
    return state.range.get() ?? { first: 0, last: Math.max((state.take.get()?.frames ?? 1) - 1, 0) };
  }

  private tick(): void {
    const take = state.take.get();
    if (!state.playing.get() || take === null) return;
    const { first, last } = this.bounds();
    const passed = ((performance.now() - this.since) / 1000) * take.rate_hz * state.speed.get();
    let due = Math.floor(this.from + passed);
    if (due > last) {
      if (!state.looping.get()) {
        state.goTo(last);
        state.playing.set(false);
        return;
      }
      this.from = first;
      this.since = performance.now();
      due = first;
    }
    if (due !== state.row.get()) {
      state.goTo(due);
      state.frames.get()?.ahead(due);
      state.joints.get()?.ahead(due);
    }
    tickSoon(this.tickNow);
  }
}
