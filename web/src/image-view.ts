// The 2D view of one camera: its image, masks, centroids, reprojections, and how far those are apart.

import { api, readOnly } from "./api";
import { drawSoon } from "./schedule";
import * as state from "./state";
import { after } from "./store";
import { css, markerColor } from "./theme";
import type { CameraFrame, CameraView } from "./wire";

const MAGNIFIED = 20;
const NEAR_PX = 10;

export class ImageView {
  private readonly canvas = document.createElement("canvas");
  private readonly context = this.canvas.getContext("2d")!;
  private zoom = 0;
  private origin: [number, number] = [0, 0];
  private image: ImageBitmap | null = null;
  private imageOf = "";
  private asked = "";
  private busy = false;
  private readonly renderNow = () => this.render();

  constructor(private readonly host: HTMLElement) {
    this.canvas.setAttribute("aria-label", "Image of the camera: centroids and reprojections");
    this.canvas.setAttribute("role", "img");
    host.append(this.canvas);
    new ResizeObserver(() => this.resize()).observe(host);
    this.canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    this.canvas.addEventListener("pointerdown", (e) => this.press(e));
    this.canvas.addEventListener("dblclick", () => this.fit());
    after([state.dots, state.selection, state.camera, state.chosenDot, state.region, state.options], () => this.draw());
    after([state.row, state.take, state.options, state.loaded], () => this.ask());
    state.camera.on(() => {
      this.fit();
      this.askImage();
    });
    state.take.on(() => this.fit());
  }

  private get view(): CameraView | null {
    return state.take.get()?.cameras[state.camera.get()] ?? null;
  }

  /** Centroids of the frame that is shown; while they are on their way no others are asked for. */
  private ask(): void {
    const take = state.take.get();
    const wanted = take === null ? "" : `${take.name} ${take.revision} ${state.row.get()}`;
    if (take === null || take.cameras.length === 0 || this.busy || this.asked === wanted || !this.visible) return;
    this.busy = true;
    this.asked = wanted;
    api
      .dots(take.name, state.frameNumber())
      .then((dots) => state.dots.set(dots))
      .catch((error) => error.kind !== "offline" && state.complain(error))
      .finally(() => {
        this.busy = false;
        this.ask();
      });
    this.askImage();
  }

  private get visible(): boolean {
    return !readOnly && state.options.get().view !== "3d";
  }

  private askImage(): void {
    const [take, camera] = [state.take.get(), this.view];
    const wanted = `${camera?.id} ${state.row.get()}`;
    if (take === null || !camera?.video || this.imageOf === wanted) {
      if (!camera?.video) this.image = null;
      return;
    }
    this.imageOf = wanted;
    api
      .video(take.name, camera.id, state.frameNumber())
      .then((blob) => createImageBitmap(blob))
      .then((image) => {
        this.image = image;
        this.draw();
      })
      .catch(state.complain);
  }

  private resize(): void {
    this.canvas.width = this.host.clientWidth * devicePixelRatio;
    this.canvas.height = this.host.clientHeight * devicePixelRatio;
    this.fit();
  }

  fit(): void {
    const camera = this.view;
    if (camera === null || this.canvas.width === 0) {
      this.draw();
      return;
    }
    const [width, height] = camera.size_px;
    this.zoom = Math.min(this.canvas.width / width, this.canvas.height / height) * 0.97;
    this.origin = [(this.canvas.width - width * this.zoom) / 2, (this.canvas.height - height * this.zoom) / 2];
    this.draw();
  }

  private at(x: number, y: number): [number, number] {
    // Pixel (0, 0) is the middle of the first pixel.
    return [this.origin[0] + (x + 0.5) * this.zoom, this.origin[1] + (y + 0.5) * this.zoom];
  }

  private pixel(event: MouseEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    const x = (event.clientX - box.left) * devicePixelRatio;
    const y = (event.clientY - box.top) * devicePixelRatio;
    return [(x - this.origin[0]) / this.zoom - 0.5, (y - this.origin[1]) / this.zoom - 0.5];
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const [x, y] = this.pixel(event);
    const [px, py] = this.at(x, y);
    this.zoom *= Math.exp(-event.deltaY * 0.0015);
    this.origin = [px - (x + 0.5) * this.zoom, py - (y + 0.5) * this.zoom];
    this.draw();
  }

  /** A drag moves the image, or with Shift marks a region; a click selects the nearest centroid. */
  private press(down: PointerEvent): void {
    const camera = this.view;
    if (camera === null) return;
    const [start, origin] = [this.pixel(down), [...this.origin]];
    let dragged = false;
    const move = (event: PointerEvent) => {
      const [dx, dy] = [event.clientX - down.clientX, event.clientY - down.clientY];
      dragged ||= Math.hypot(dx, dy) > 4;
      if (!dragged) return;
      if (down.shiftKey) {
        const end = this.pixel(event);
        const low: [number, number] = [Math.min(start[0], end[0]), Math.min(start[1], end[1])];
        const high: [number, number] = [Math.max(start[0], end[0]), Math.max(start[1], end[1])];
        state.region.set({ camera: camera.id, low, high });
      } else {
        this.origin = [origin[0] + dx * devicePixelRatio, origin[1] + dy * devicePixelRatio];
        this.draw();
      }
    };
    const release = () => {
      removeEventListener("pointermove", move);
      removeEventListener("pointerup", release);
      if (!dragged) this.click(start, down.shiftKey);
    };
    addEventListener("pointermove", move);
    addEventListener("pointerup", release);
  }

  private click([x, y]: [number, number], add: boolean): void {
    const [frame, camera] = [this.frame, this.view];
    if (frame === null || camera === null) return;
    state.region.set(null);
    const near = [...frame.dots]
      .map((dot) => ({ dot, away: Math.hypot(dot.x - x, dot.y - y) * this.zoom }))
      .filter((c) => c.away < NEAR_PX * devicePixelRatio * 1.5)
      .sort((a, b) => a.away - b.away)[0]?.dot;
    state.chosenDot.set(near ? { camera: camera.id, frame: state.frameNumber(), x: near.x, y: near.y } : null);
    if (near && near.slot >= 0)
      state.selection.update((s) => (add ? [...s.filter((i) => i !== near.slot), near.slot] : [near.slot]));
  }

  private get frame(): CameraFrame | null {
    return state.dots.get()?.cameras.find((c) => c.camera === this.view?.id) ?? null;
  }

  draw(): void {
    drawSoon(this.renderNow);
  }

  private render(): void {
    const context = this.context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = css("--stage");
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    const camera = this.view;
    if (camera === null) {
      this.sayEmpty();
      return;
    }
    const [width, height] = camera.size_px;
    const [x0, y0] = this.at(-0.5, -0.5);
    context.fillStyle = "#0b0f14";
    context.fillRect(x0, y0, width * this.zoom, height * this.zoom);
    if (this.image && camera.video) context.drawImage(this.image, x0, y0, width * this.zoom, height * this.zoom);
    context.fillStyle = "rgba(214,124,177,0.25)";
    for (const [ax, ay, bx, by] of camera.masked) {
      const [px, py] = this.at(ax, ay);
      context.fillRect(px, py, (bx - ax) * this.zoom, (by - ay) * this.zoom);
    }
    const frame = this.frame;
    if (frame !== null) this.drawDots(frame);
    const region = state.region.get();
    if (region?.camera === camera.id) {
      const [px, py] = this.at(...region.low);
      context.strokeStyle = "#e69f00";
      context.setLineDash([6, 4]);
      context.strokeRect(
        px,
        py,
        (region.high[0] - region.low[0]) * this.zoom,
        (region.high[1] - region.low[1]) * this.zoom,
      );
      context.setLineDash([]);
    }
  }

  private drawDots(frame: CameraFrame): void {
    const context = this.context;
    const take = state.take.get()!;
    const selected = new Set(state.selection.get());
    const scale = devicePixelRatio;
    const places = new Map(frame.reprojections.map((r) => [r.slot, r]));
    context.lineWidth = scale;
    for (const r of frame.reprojections) {
      const [x, y] = this.at(r.x, r.y);
      context.strokeStyle = selected.has(r.slot) ? css("--selected-2d") : "rgba(255,255,255,0.45)";
      const arm = (selected.has(r.slot) ? 9 : 5) * scale;
      context.beginPath();
      context.moveTo(x - arm, y);
      context.lineTo(x + arm, y);
      context.moveTo(x, y - arm);
      context.lineTo(x, y + arm);
      context.stroke();
    }
    for (const dot of frame.dots) {
      const [x, y] = this.at(dot.x, dot.y);
      const one = take.trajectories[dot.slot];
      const chosen = state.chosenDot.get();
      const isChosen = chosen !== null && chosen.camera === frame.camera && chosen.x === dot.x && chosen.y === dot.y;
      context.beginPath();
      context.arc(x, y, (selected.has(dot.slot) || isChosen ? 5.5 : 3.2) * scale, 0, 7);
      if (dot.excluded) {
        context.strokeStyle = "#d55e00";
        context.stroke();
        context.beginPath();
        context.moveTo(x - 4 * scale, y - 4 * scale);
        context.lineTo(x + 4 * scale, y + 4 * scale);
        context.stroke();
        continue;
      }
      // Filled: it made a marker; hollow: nobody's.
      context.fillStyle = context.strokeStyle = one ? markerColor(one.color, one.label, dot.slot) : "#ffffff";
      if (one) context.fill();
      else context.stroke();
      if (isChosen) {
        context.strokeStyle = css("--selected-2d");
        context.stroke();
      }
      const place = places.get(dot.slot);
      if (place) {
        context.strokeStyle = "#f0e442";
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(x + (place.x - dot.x) * MAGNIFIED * this.zoom, y + (place.y - dot.y) * MAGNIFIED * this.zoom);
        context.stroke();
      }
    }
  }

  private sayEmpty(): void {
    const context = this.context;
    context.fillStyle = css("--muted");
    context.font = `${13 * devicePixelRatio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillText(
      "No calibration: there is no camera to look through.",
      this.canvas.width / 2,
      this.canvas.height / 2,
    );
    context.fillText(
      "Say --calibration to `markerloom view`.",
      this.canvas.width / 2,
      this.canvas.height / 2 + 20 * devicePixelRatio,
    );
  }
}
