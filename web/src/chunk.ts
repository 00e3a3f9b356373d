// Samples as the server sends them: the layout is documented in docs/reference/studio.md.

export interface Chunk {
  first: number;
  frames: number;
  slots: number;
  revision: number;
  xyz: Float32Array;
  sigma: Float32Array | null;
  residual: Float32Array | null;
  kind: Int8Array | null;
}

export const ABSENT = -1;
export const KINDS = ["measured", "predicted", "filled", "edited"] as const;
const MAGIC = 0x4b434c4d; // "MLCK"
const VERSION = 1;
const HEADER = 24;
const SIGMAS = 1;
const RESIDUALS = 2;
const KIND_FLAG = 4;

export function decode(buffer: ArrayBuffer): Chunk {
  if (buffer.byteLength < HEADER) throw new Error("a chunk is cut off before its header ends");
  const head = new DataView(buffer);
  if (head.getUint32(0, true) !== MAGIC) throw new Error("this is no chunk of samples");
  const version = head.getUint16(4, true);
  if (version !== VERSION) throw new Error(`chunks of version ${version} are not known: load the page again`);
  const flags = head.getUint16(6, true);
  const [first, frames, slots, revision] = [8, 12, 16, 20].map((at) => head.getUint32(at, true));
  const samples = frames * slots;
  const size =
    HEADER + samples * (12 + (flags & SIGMAS ? 4 : 0) + (flags & RESIDUALS ? 4 : 0) + (flags & KIND_FLAG ? 1 : 0));
  if (buffer.byteLength !== size) throw new Error(`a chunk has ${buffer.byteLength} bytes instead of ${size}`);
  let at = HEADER;
  const floats = (count: number) => {
    const part = new Float32Array(buffer, at, count);
    at += 4 * count;
    return part;
  };
  const xyz = floats(3 * samples);
  const sigma = flags & SIGMAS ? floats(samples) : null;
  const residual = flags & RESIDUALS ? floats(samples) : null;
  const kind = flags & KIND_FLAG ? new Int8Array(buffer, at, samples) : null;
  return { first, frames, slots, revision, xyz, sigma, residual, kind };
}

/** One frame of a chunk. */
export interface Frame {
  slots: number;
  xyz: Float32Array;
  sigma: Float32Array | null;
  residual: Float32Array | null;
  kind: Int8Array | null;
}

export function frameOf(chunk: Chunk, row: number): Frame {
  const low = (row - chunk.first) * chunk.slots;
  const high = low + chunk.slots;
  return {
    slots: chunk.slots,
    xyz: chunk.xyz.subarray(3 * low, 3 * high),
    sigma: chunk.sigma?.subarray(low, high) ?? null,
    residual: chunk.residual?.subarray(low, high) ?? null,
    kind: chunk.kind?.subarray(low, high) ?? null,
  };
}
