// The 3D view: floor, cameras, markers, trails, links, rays and the skeleton. Metres, Z up.

import {
  AmbientLight,
  AxesHelper,
  BufferAttribute,
  BufferGeometry,
  Color,
  ConeGeometry,
  DirectionalLight,
  DoubleSide,
  DynamicDrawUsage,
  GridHelper,
  Group,
  IcosahedronGeometry,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  PlaneGeometry,
  Quaternion,
  Scene,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { ABSENT } from "./chunk";
import { drawSoon } from "./schedule";
import * as state from "./state";
import { css, heat, KIND_COLORS, markerColor } from "./theme";
import type { CameraView } from "./wire";

const TRAIL_FRAMES = 120;
const MOST_OF_PATH = 4000;
const FRUSTUM_M = 0.35;
const PICKED_PX = 14;
const SPREAD_MM = 5;

/** Lines whose ends change with every frame; they never shrink, and only what is used is drawn. */
class Lines {
  readonly object: LineSegments<BufferGeometry, LineBasicMaterial>;
  private used = 0;

  constructor(color: string, opacity = 1) {
    const material = new LineBasicMaterial({ color, transparent: opacity < 1, opacity });
    this.object = new LineSegments(new BufferGeometry(), material);
    this.object.frustumCulled = false;
    this.grow(64);
  }

  begin(): void {
    this.used = 0;
  }

  add(ax: number, ay: number, az: number, bx: number, by: number, bz: number): void {
    const attribute = this.object.geometry.getAttribute("position") as BufferAttribute;
    if (3 * this.used + 6 > attribute.array.length) this.grow(attribute.array.length / 3);
    const array = this.object.geometry.getAttribute("position").array as Float32Array;
    array.set([ax, ay, az, bx, by, bz], 3 * this.used);
    this.used += 2;
  }

  end(): void {
    this.object.geometry.setDrawRange(0, this.used);
    (this.object.geometry.getAttribute("position") as BufferAttribute).needsUpdate = true;
  }

  private grow(vertices: number): void {
    const array = new Float32Array(6 * vertices);
    const old = this.object.geometry.getAttribute("position");
    if (old) array.set(old.array as Float32Array);
    const attribute = new BufferAttribute(array, 3);
    attribute.setUsage(DynamicDrawUsage);
    this.object.geometry.setAttribute("position", attribute);
  }
}

/** Whether there is no graphics processor: then less is drawn, so that it is drawn in time. */
function drawnBySoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const told = context?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? String(context!.getParameter(told.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class View3D {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly world = new Group();
  private readonly eye = new PerspectiveCamera(50, 1, 0.01, 500);
  private readonly controls: OrbitControls;
  private readonly overlay: CanvasRenderingContext2D;
  private markers: InstancedMesh | null = null;
  private bones: InstancedMesh | null = null;
  private grid: GridHelper | null = null;
  private readonly frusta = new Lines("#8fa3b5", 0.8);
  private readonly links = new Lines("#8fa3b5", 0.55);
  private readonly trails = new Lines("#56b4e9", 0.8);
  private readonly path = new Lines("#9a7fd1", 0.7);
  private pathOf = "";
  private readonly rays = new Lines("#f0e442", 0.9);
  private readonly refined = new Lines("#d55e00");
  private cells: InstancedMesh | null = null;
  private readonly ghost = new Lines("#1aa67d");
  private readonly renderNow = () => this.render();
  private fitted = "";
  private middle = new Vector3();
  /** How many frames of the take were drawn with their samples: for measurements. */
  drawn = 0;
  private readonly detail: number;
  private named = false;

  /** Throws where the browser has no WebGL. */
  constructor(private readonly host: HTMLElement) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    const text = document.createElement("canvas");
    text.className = "overlay";
    text.setAttribute("aria-hidden", "true");
    const software = drawnBySoftware();
    this.renderer = new WebGLRenderer({ canvas, antialias: !software, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(software ? 1 : Math.min(devicePixelRatio, 2));
    this.detail = software ? 1 : 2;
    host.append(canvas, text);
    this.overlay = text.getContext("2d")!;
    this.eye.up.set(0, 0, 1);
    this.eye.position.set(4, -4, 2.5);
    this.controls = new OrbitControls(this.eye, canvas);
    this.controls.target.set(0, 0, 0.9);
    this.controls.addEventListener("change", () => this.draw());
    const sun = new DirectionalLight("#ffffff", 2.2);
    sun.position.set(2, -3, 5);
    this.scene.add(new AmbientLight("#ffffff", 1.6), sun, this.world);
    for (const lines of [this.frusta, this.links, this.trails, this.path, this.rays, this.ghost, this.refined])
      this.world.add(lines.object);
    const axes = new AxesHelper(0.3);
    this.world.add(axes);
    new ResizeObserver(() => this.resize()).observe(host);
    canvas.addEventListener("pointerdown", (e) => this.press(e));
    this.resize();
  }

  /** Draw soon, however often it is asked for. */
  draw(): void {
    drawSoon(this.renderNow);
  }

  /** The floor, the cameras and the room for markers of another take. */
  newTake(): void {
    const take = state.take.get();
    this.markers?.removeFromParent();
    this.markers?.dispose();
    this.bones?.removeFromParent();
    this.bones?.dispose();
    this.markers = this.bones = null;
    if (take === null) return;
    const slots = Math.max(take.trajectories.length, 1);
    this.markers = new InstancedMesh(
      new IcosahedronGeometry(1, slots > 200 ? this.detail - 1 : this.detail),
      new MeshLambertMaterial(),
      slots,
    );
    this.markers.instanceMatrix.setUsage(DynamicDrawUsage);
    this.markers.frustumCulled = false;
    this.markers.setColorAt(0, new Color());
    this.world.add(this.markers);
    if (take.skeleton) {
      const bone = new ConeGeometry(0.16, 1, 6).translate(0, 0.5, 0);
      const material = new MeshLambertMaterial({ color: "#b9c4cf" });
      this.bones = new InstancedMesh(bone, material, take.skeleton.joints.length + take.skeleton.ends.length);
      this.bones.instanceMatrix.setUsage(DynamicDrawUsage);
      this.bones.frustumCulled = false;
      this.world.add(this.bones);
    }
    drawFrusta(this.frusta, take.cameras);
    this.theme();
  }

  theme(): void {
    const size = 10;
    this.grid?.removeFromParent();
    this.grid = new GridHelper(size, 2 * size, css("--grid-strong"), css("--grid"));
    this.grid.rotation.x = Math.PI / 2;
    this.world.add(this.grid);
    this.scene.background = new Color(css("--stage"));
    this.draw();
  }

  /** Look at everything that is there now. */
  fit(): void {
    const box = this.bounds();
    if (box === null) return;
    const { middle, radius } = box;
    const away = Math.max(radius, 0.5) / Math.sin((this.eye.fov * Math.PI) / 360) / Math.min(this.eye.aspect, 1.2);
    const direction = this.eye.position.clone().sub(this.controls.target).normalize();
    this.controls.target.copy(middle);
    this.eye.position.copy(middle).addScaledVector(direction, 1.15 * away);
    this.controls.update();
    this.draw();
  }

  private bounds(): { middle: Vector3; radius: number } | null {
    const points = this.places();
    if (points.length === 0) return null;
    const low = points[0].clone();
    const high = points[0].clone();
    for (const p of points) {
      low.min(p);
      high.max(p);
    }
    return { middle: low.clone().add(high).multiplyScalar(0.5), radius: 0.5 * high.distanceTo(low) };
  }

  /** Places in the scene of markers, or of joints where there are none. */
  private places(): Vector3[] {
    const found: Vector3[] = [];
    for (const store of [state.frames, state.joints]) {
      const frame = store.get()?.get(state.row.get());
      for (let i = 0; frame && i < frame.slots; i += 1) {
        const p = new Vector3(frame.xyz[3 * i], frame.xyz[3 * i + 1], frame.xyz[3 * i + 2]).multiplyScalar(0.001);
        if (Number.isFinite(p.x)) found.push(this.world.localToWorld(p));
      }
      if (found.length > 0) break;
    }
    return found;
  }

  /** Where the cameras would stand after adjusting them to the take, in another colour. */
  showRefined(): void {
    drawFrusta(this.refined, state.refined.get()?.cameras ?? []);
    this.draw();
  }

  /** A layer of the planner's map: a square for each cell that two cameras see, from dark (good) to light (bad). */
  showAccuracy(): void {
    this.cells?.removeFromParent();
    this.cells?.dispose();
    this.cells = null;
    const shown = state.accuracy.get();
    if (shown !== null) {
      const { map, layer } = shown;
      const [nx, ny, nz] = [map.x_m.length, map.y_m.length, map.z_m.length];
      const step = nx > 1 ? map.x_m[1] - map.x_m[0] : 0.2;
      const material = new MeshBasicMaterial({ transparent: true, opacity: 0.55, side: DoubleSide, depthWrite: false });
      const mesh = new InstancedMesh(new PlaneGeometry(0.94 * step, 0.94 * step), material, nx * ny);
      const matrix = new Matrix4();
      const color = new Color();
      let used = 0;
      for (let i = 0; i < nx; i += 1) {
        for (let j = 0; j < ny; j += 1) {
          const sigma = map.sigma_mm[(i * ny + j) * nz + layer];
          if (sigma < 0) continue;
          matrix.makeTranslation(map.x_m[i], map.y_m[j], map.z_m[layer]);
          mesh.setMatrixAt(used, matrix);
          mesh.setColorAt(used, color.set(heat(sigma / (4 * map.median_mm || 1))));
          used += 1;
        }
      }
      mesh.count = used;
      mesh.frustumCulled = false;
      this.world.add(mesh);
      this.cells = mesh;
    }
    this.draw();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.overlay.canvas.width = width * devicePixelRatio;
    this.overlay.canvas.height = height * devicePixelRatio;
    this.overlay.canvas.style.width = `${width}px`;
    this.overlay.canvas.style.height = `${height}px`;
    this.eye.aspect = width / height;
    this.eye.updateProjectionMatrix();
    this.draw();
  }

  private render(): void {
    const take = state.take.get();
    const options = state.options.get();
    this.world.rotation.x = options.up === "y" ? Math.PI / 2 : 0;
    this.world.updateMatrixWorld();
    if (take !== null) {
      this.updateMarkers();
      this.updateBones();
      this.updateLinks();
      this.updateTrails();
      this.updateRays();
      this.updatePreview();
      this.frusta.object.visible = options.cameras;
      this.followMiddle(take.name);
    }
    this.renderer.render(this.scene, this.eye);
    this.writeNames();
  }

  /** The first time a take is drawn it is fitted; later the eye goes along, where that is wished. */
  private followMiddle(name: string): void {
    const box = this.bounds();
    if (box === null) return;
    if (this.fitted !== name) {
      this.fitted = name;
      this.middle = box.middle;
      this.fit();
      return;
    }
    if (state.options.get().follow) {
      const by = box.middle.clone().sub(this.middle);
      this.eye.position.add(by);
      this.controls.target.add(by);
      this.controls.update();
    }
    this.middle = box.middle;
  }

  private updateMarkers(): void {
    const mesh = this.markers;
    const frame = state.frames.get()?.get(state.row.get());
    if (mesh === null || frame === null || frame === undefined) return;
    const { colorBy, radius_mm } = state.options.get();
    const take = state.take.get()!;
    const selected = new Set(state.selection.get());
    const matrix = new Matrix4();
    const color = new Color();
    const slots = Math.min(frame.slots, mesh.instanceMatrix.count);
    for (let i = 0; i < slots; i += 1) {
      const there = frame.kind === null || frame.kind[i] !== ABSENT;
      const size = there ? (radius_mm / 1000) * (selected.has(i) ? 1.6 : 1) : 0;
      matrix.makeScale(size, size, size);
      if (there) matrix.setPosition(frame.xyz[3 * i] / 1e3, frame.xyz[3 * i + 1] / 1e3, frame.xyz[3 * i + 2] / 1e3);
      mesh.setMatrixAt(i, matrix);
      const one = take.trajectories[i];
      const kind = Math.max(frame.kind?.[i] ?? 0, 0);
      if (selected.has(i)) color.set(css("--selected"));
      else if (colorBy === "kind") color.set(KIND_COLORS[kind]);
      else if (colorBy === "residual") color.set(heat((frame.residual?.[i] ?? 0) / (4 * take.typical_residual || 1)));
      else if (colorBy === "confidence") color.set(heat((frame.sigma?.[i] ?? 0) / SPREAD_MM));
      else color.set(markerColor(one?.color ?? "", one?.label ?? "", i));
      mesh.setColorAt(i, color);
    }
    if (state.drawnRow.get() !== state.row.get()) this.drawn += 1;
    state.drawnRow.set(state.row.get());
    mesh.count = slots;
    mesh.instanceMatrix.needsUpdate = true;
    if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }

  private updateBones(): void {
    const mesh = this.bones;
    const skeleton = state.take.get()?.skeleton;
    const frame = state.joints.get()?.get(state.row.get());
    if (mesh === null || !skeleton) return;
    mesh.visible = state.options.get().skeleton && Boolean(frame);
    if (!frame || !mesh.visible) return;
    const up = new Vector3(0, 1, 0);
    const [from, to, along] = [new Vector3(), new Vector3(), new Vector3()];
    const turn = new Quaternion();
    const matrix = new Matrix4();
    let used = 0;
    // Bones from joint to joint, and from the last joints to the ends that come after all joints.
    [...skeleton.parents, ...skeleton.ends].forEach((parent, joint) => {
      if (parent < 0) return;
      from.fromArray(frame.xyz, 3 * parent).multiplyScalar(0.001);
      to.fromArray(frame.xyz, 3 * joint).multiplyScalar(0.001);
      along.subVectors(to, from);
      const length = along.length();
      if (length < 1e-6) return;
      turn.setFromUnitVectors(up, along.divideScalar(length));
      const thick = Math.min(length, 0.25);
      matrix.compose(from, turn, new Vector3(thick, length, thick));
      mesh.setMatrixAt(used, matrix);
      used += 1;
    });
    mesh.count = used;
    mesh.instanceMatrix.needsUpdate = true;
  }

  private updateLinks(): void {
    const frame = state.frames.get()?.peek(state.row.get());
    this.links.object.visible = state.options.get().links;
    this.links.begin();
    for (const [a, b] of frame && this.links.object.visible ? state.take.get()!.links : []) {
      const [p, q] = [3 * a, 3 * b];
      const xyz = frame!.xyz;
      if (Number.isNaN(xyz[p]) || Number.isNaN(xyz[q])) continue;
      this.links.add(
        xyz[p] / 1e3,
        xyz[p + 1] / 1e3,
        xyz[p + 2] / 1e3,
        xyz[q] / 1e3,
        xyz[q + 1] / 1e3,
        xyz[q + 2] / 1e3,
      );
    }
    this.links.end();
  }

  /** Where the selected markers come from and go to, as far as those frames are at hand. */
  private updateTrails(): void {
    const store = state.frames.get();
    this.trails.begin();
    const selected = state.options.get().trails ? state.selection.get() : [];
    for (const slot of store ? selected : []) {
      let before: Float32Array | null = null;
      for (let r = state.row.get() - TRAIL_FRAMES; r <= state.row.get() + TRAIL_FRAMES; r += 1) {
        const frame = r < 0 ? null : store!.peek(r);
        const here = frame ? frame.xyz.subarray(3 * slot, 3 * slot + 3) : null;
        const there = here !== null && here.length === 3 && !Number.isNaN(here[0]);
        if (there && before) {
          this.trails.add(
            before[0] / 1e3,
            before[1] / 1e3,
            before[2] / 1e3,
            here[0] / 1e3,
            here[1] / 1e3,
            here[2] / 1e3,
          );
        }
        before = there ? here : null;
      }
    }
    this.trails.end();
    this.updatePath(selected);
  }

  /** The way of the selected markers through the whole take, such as that of a wand, by every n-th frame. */
  private updatePath(selected: readonly number[]): void {
    const key = `${selected.join()} ${state.loaded.get()} ${state.options.get().path}`;
    if (key === this.pathOf) return;
    this.pathOf = key;
    this.path.begin();
    const store = state.frames.get();
    const total = state.take.get()!.frames;
    const stride = Math.max(store?.stride ?? 0, Math.ceil(total / MOST_OF_PATH));
    for (const slot of state.options.get().path && store ? selected : []) {
      let before: Float32Array | null = null;
      for (let r = 0; r < total; r += stride) {
        const here = store!.peek(r)?.xyz.subarray(3 * slot, 3 * slot + 3) ?? null;
        const there = here !== null && here.length === 3 && !Number.isNaN(here[0]);
        if (there && before)
          this.path.add(before[0] / 1e3, before[1] / 1e3, before[2] / 1e3, here[0] / 1e3, here[1] / 1e3, here[2] / 1e3);
        before = there ? here : null;
      }
    }
    this.path.end();
  }

  private updateRays(): void {
    this.rays.begin();
    const why = state.options.get().rays ? state.why.get() : null;
    const take = state.take.get()!;
    const slot = state.selection.get().at(-1);
    const frame = state.frames.get()?.peek(state.row.get());
    if (why !== null && slot !== undefined && frame && !Number.isNaN(frame.xyz[3 * slot])) {
      const marker = new Vector3().fromArray(frame.xyz, 3 * slot).multiplyScalar(0.001);
      for (const ray of why.rays) {
        const camera = take.cameras.find((c) => c.id === ray.camera);
        if (camera === undefined) continue;
        const at = new Vector3(...camera.position_m);
        const end = at.clone().addScaledVector(new Vector3(...ray.direction), at.distanceTo(marker));
        this.rays.add(at.x, at.y, at.z, end.x, end.y, end.z);
      }
    }
    this.rays.end();
  }

  private updatePreview(): void {
    this.ghost.begin();
    const xyz = state.preview.get()?.xyz_mm ?? [];
    for (let i = 1; i < xyz.length; i += 1) {
      const [a, b] = [xyz[i - 1], xyz[i]];
      this.ghost.add(a[0] / 1e3, a[1] / 1e3, a[2] / 1e3, b[0] / 1e3, b[1] / 1e3, b[2] / 1e3);
    }
    this.ghost.end();
  }

  /** Where markers are on the screen: x, y (px), and the slot. */
  private onScreen(): [number, number, number][] {
    const frame = state.frames.get()?.peek(state.row.get());
    const found: [number, number, number][] = [];
    const { clientWidth: width, clientHeight: height } = this.host;
    const p = new Vector3();
    for (let i = 0; frame && i < frame.slots; i += 1) {
      if (Number.isNaN(frame.xyz[3 * i])) continue;
      p.fromArray(frame.xyz, 3 * i).multiplyScalar(0.001);
      this.world.localToWorld(p).project(this.eye);
      if (p.z < 1) found.push([(0.5 + 0.5 * p.x) * width, (0.5 - 0.5 * p.y) * height, i]);
    }
    return found;
  }

  /** A click selects, a drag turns the view. */
  private press(down: PointerEvent): void {
    const release = (up: PointerEvent) => {
      removeEventListener("pointerup", release);
      if (Math.hypot(up.clientX - down.clientX, up.clientY - down.clientY) > 4) return;
      const box = this.host.getBoundingClientRect();
      const [x, y] = [up.clientX - box.left, up.clientY - box.top];
      const nearest = this.onScreen()
        .map(([px, py, slot]) => ({ away: Math.hypot(px - x, py - y), slot }))
        .filter((c) => c.away < PICKED_PX)
        .sort((a, b) => a.away - b.away)[0];
      picked(nearest?.slot ?? null, up.shiftKey || up.ctrlKey || up.metaKey);
    };
    addEventListener("pointerup", release);
  }

  private writeNames(): void {
    const context = this.overlay;
    const { width, height } = context.canvas;
    const take = state.take.get();
    const all = state.options.get().names;
    const selected = new Set(state.selection.get());
    const wanted = take !== null && (all || selected.size > 0);
    if (wanted || this.named) context.clearRect(0, 0, width, height);
    this.named = wanted;
    if (!wanted) return;
    context.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    context.lineWidth = 3 * devicePixelRatio;
    context.strokeStyle = css("--stage");
    context.fillStyle = css("--text");
    for (const [x, y, slot] of this.onScreen()) {
      if (!all && !selected.has(slot)) continue;
      const name = take.trajectories[slot]?.name ?? "";
      const [px, py] = [(x + 9) * devicePixelRatio, (y - 7) * devicePixelRatio];
      context.strokeText(name, px, py);
      context.fillText(name, px, py);
    }
  }
}

/** Cameras as pyramids of what they see, half an arm long. */
function drawFrusta(lines: Lines, cameras: readonly CameraView[]): void {
  lines.begin();
  for (const camera of cameras) {
    const at = new Vector3(...camera.position_m);
    const [right, down, forward] = camera.axes.map((a) => new Vector3(...a));
    const corner = (sx: number, sy: number) =>
      at
        .clone()
        .addScaledVector(forward, FRUSTUM_M)
        .addScaledVector(right, (sx * 0.5 * camera.size_px[0] * FRUSTUM_M) / camera.focal_px[0])
        .addScaledVector(down, (sy * 0.5 * camera.size_px[1] * FRUSTUM_M) / camera.focal_px[1]);
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    corners.forEach((c, i) => {
      const next = corners[(i + 1) % 4];
      lines.add(at.x, at.y, at.z, c.x, c.y, c.z);
      lines.add(c.x, c.y, c.z, next.x, next.y, next.z);
    });
  }
  lines.end();
}

let picked: (slot: number | null, add: boolean) => void = () => {};

/** What happens when a marker is clicked, or the empty room. */
export function onPick(what: typeof picked): void {
  picked = what;
}
