// Frames on demand: chunks are asked for when they are looked at, the last wish first, and the oldest are forgotten.

import { type Chunk, decode, type Frame, frameOf } from "./chunk";

const KEPT = 96;
const AT_ONCE = 2;

export class FrameStore {
  private chunks = new Map<number, Chunk>();
  private loading = new Set<number>();
  private wanted: number[] = [];
  private overview: Chunk | null = null;
  /** Of how many frames the overview has one. */
  stride = 0;

  constructor(
    readonly chunkFrames: number,
    readonly frames: number,
    private readonly load: (first: number, count: number) => Promise<ArrayBuffer>,
    private readonly arrived: () => void,
    private readonly failed: (error: unknown) => void,
  ) {}

  /** A frame, where it is at hand; it is asked for otherwise. */
  get(row: number): Frame | null {
    const index = Math.floor(row / this.chunkFrames);
    const chunk = this.chunks.get(index);
    if (chunk === undefined) {
      const known = this.fromOverview(row);
      if (known === null) this.want(index);
      return known;
    }
    // What was looked at last is forgotten last.
    this.chunks.delete(index);
    this.chunks.set(index, chunk);
    return row - chunk.first < chunk.frames ? frameOf(chunk, row) : null;
  }

  /** A frame, only where it is at hand. */
  peek(row: number): Frame | null {
    const chunk = this.chunks.get(Math.floor(row / this.chunkFrames));
    if (chunk === undefined) return this.fromOverview(row);
    return row - chunk.first < chunk.frames ? frameOf(chunk, row) : null;
  }

  /** Every n-th frame of the whole take, to be at hand at once wherever one looks. */
  addOverview(stride: number, buffer: ArrayBuffer): void {
    this.overview = decode(buffer);
    this.stride = stride;
  }

  private fromOverview(row: number): Frame | null {
    if (this.overview === null || row % this.stride !== 0) return null;
    const index = row / this.stride;
    return index < this.overview.frames ? frameOf(this.overview, index) : null;
  }

  /** Ask for the chunk that comes next when playing. */
  ahead(row: number): void {
    const index = Math.floor(row / this.chunkFrames) + 1;
    if (index * this.chunkFrames < this.frames && !this.chunks.has(index)) this.want(index);
  }

  private want(index: number): void {
    if (this.loading.has(index)) return;
    this.wanted = [index, ...this.wanted.filter((i) => i !== index)].slice(0, AT_ONCE);
    this.next();
  }

  private next(): void {
    while (this.loading.size < AT_ONCE && this.wanted.length > 0) {
      const index = this.wanted.shift()!;
      this.loading.add(index);
      this.load(index * this.chunkFrames, this.chunkFrames).then(
        (buffer) => this.keep(index, buffer),
        (error) => {
          this.loading.delete(index);
          this.failed(error);
        },
      );
    }
  }

  private keep(index: number, buffer: ArrayBuffer): void {
    this.loading.delete(index);
    this.chunks.set(index, decode(buffer));
    for (const oldest of this.chunks.keys()) {
      if (this.chunks.size <= KEPT) break;
      this.chunks.delete(oldest);
    }
    this.next();
    this.arrived();
  }
}
