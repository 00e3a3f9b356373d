import { describe, expect, it } from "vitest";
import { decode, frameOf } from "../src/chunk";
import { FrameStore } from "../src/frames";

/** A chunk as the server writes it: place x of slot s in frame f is 100 f + s. */
export function written(first: number, frames: number, slots: number, flags = 7, version = 1): ArrayBuffer {
  const n = frames * slots;
  const size = 24 + n * (12 + (flags & 1 ? 4 : 0) + (flags & 2 ? 4 : 0) + (flags & 4 ? 1 : 0));
  const buffer = new ArrayBuffer(size);
  const view = new DataView(buffer);
  [0x4d, 0x4c, 0x43, 0x4b].forEach((byte, i) => {
    view.setUint8(i, byte);
  });
  view.setUint16(4, version, true);
  view.setUint16(6, flags, true);
  [first, frames, slots, 9].forEach((value, i) => {
    view.setUint32(8 + 4 * i, value, true);
  });
  let at = 24;
  const float = (value: number) => {
    view.setFloat32(at, value, true);
    at += 4;
  };
  for (let f = 0; f < frames; f += 1)
    for (let s = 0; s < slots; s += 1)
      for (const part of [100 * (first + f) + s, 0.5, s === 1 ? Number.NaN : 2]) float(part);
  if (flags & 1) for (let i = 0; i < n; i += 1) float(0.25);
  if (flags & 2) for (let i = 0; i < n; i += 1) float(i);
  if (flags & 4) for (let i = 0; i < n; i += 1) view.setInt8(at + i, (i % 3) - 1);
  return buffer;
}

describe("a chunk", () => {
  it("is read as it was written", () => {
    const chunk = decode(written(128, 4, 3));
    expect([chunk.first, chunk.frames, chunk.slots, chunk.revision]).toEqual([128, 4, 3, 9]);
    const frame = frameOf(chunk, 130);
    expect([...frame.xyz.slice(0, 3)]).toEqual([13000, 0.5, 2]);
    expect(frame.xyz[5]).toBeNaN();
    expect([...frame.residual!]).toEqual([6, 7, 8]);
    expect([...frame.kind!]).toEqual([-1, 0, 1]);
    expect(frame.sigma![0]).toBe(0.25);
  });

  it("may hold places alone", () => {
    const chunk = decode(written(0, 2, 5, 0));
    expect([chunk.sigma, chunk.residual, chunk.kind]).toEqual([null, null, null]);
    expect(frameOf(chunk, 1).xyz[0]).toBe(100);
  });

  it("is refused when it is cut, something else, or of another version", () => {
    expect(() => decode(new ArrayBuffer(3))).toThrow("cut off");
    expect(() => decode(new ArrayBuffer(30))).toThrow("no chunk");
    expect(() => decode(written(0, 2, 2, 7, 2))).toThrow("version 2");
    expect(() => decode(written(0, 2, 2).slice(0, -1))).toThrow("instead of");
  });
});

const never = () => expect.unreachable();

describe("the store of frames", () => {
  const settled = () => new Promise((done) => setTimeout(done, 5));

  it("asks for a chunk once, and tells when it is there", async () => {
    const asked: number[] = [];
    let arrived = 0;
    const load = async (first: number, count: number) => {
      asked.push(first);
      return written(first, count, 2);
    };
    const store = new FrameStore(16, 100, load, () => arrived++, never);
    expect(store.get(20)).toBeNull();
    expect(store.get(21)).toBeNull();
    await settled();
    expect([asked, arrived]).toEqual([[16], 1]);
    expect(store.get(20)!.xyz[0]).toBe(2000);
    expect(store.peek(40)).toBeNull();
    store.ahead(20);
    await settled();
    expect(asked).toEqual([16, 32]);
    store.ahead(99);
    expect(asked.length).toBe(2);
  });

  it("serves the last wish first when wishes come faster than answers", async () => {
    const asked: number[] = [];
    const waiting: (() => void)[] = [];
    const load = (first: number, count: number) => {
      asked.push(first);
      return new Promise<ArrayBuffer>((done) => waiting.push(() => done(written(first, count, 1))));
    };
    const store = new FrameStore(10, 1000, load, () => {}, never);
    for (let row = 0; row < 1000; row += 10) store.get(row);
    expect(asked).toEqual([0, 10]);
    waiting.shift()!();
    await settled();
    expect(asked[2]).toBe(990);
  });

  it("tells what went wrong, and may be asked again", async () => {
    const errors: unknown[] = [];
    const store = new FrameStore(
      10,
      100,
      () => Promise.reject(new Error("gone")),
      () => {},
      (e) => errors.push(e),
    );
    store.get(0);
    await settled();
    store.get(0);
    await settled();
    expect(errors.length).toBe(2);
  });
});
