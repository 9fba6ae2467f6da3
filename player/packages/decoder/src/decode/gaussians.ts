/** Decoding of the points of a file in the paper's codec: all sections except the offsets. */
import { inSection, ReelError } from "../base/errors";
import type { Container } from "../reel/container";
import { integers, linear, numbersOf, sectionOf, short, tensor, whole } from "./dequantize";

const DIGIT_BITS = 4;
const MAX_BITS = 21;

/** SPREAD[v]: the four bits of v with two zero bits between them. */
const SPREAD = Uint16Array.from(
  { length: 1 << DIGIT_BITS },
  (_, v) => (v & 1) | ((v & 2) << 2) | ((v & 4) << 4) | ((v & 8) << 6),
);

/**
 * Return the stable order [N] of lattice points [N, 3] (0 <= q < 2^21) by Morton code.
 * It is a radix sort with digits of four bits per axis, so that no 63-bit code is formed.
 */
export function mortonOrder(q: ArrayLike<number>): Uint32Array {
  const count = q.length / 3;
  let order = Uint32Array.from({ length: count }, (_, i) => i);
  let next = new Uint32Array(count);
  const digits = new Uint16Array(count);
  for (let shift = 0; shift < MAX_BITS; shift += DIGIT_BITS) {
    const starts = new Uint32Array((1 << (3 * DIGIT_BITS)) + 1);
    for (let i = 0; i < count; i++) {
      const x = SPREAD[(q[3 * i] >> shift) & 15];
      const y = SPREAD[(q[3 * i + 1] >> shift) & 15];
      const z = SPREAD[(q[3 * i + 2] >> shift) & 15];
      digits[i] = x | (y << 1) | (z << 2);
      starts[digits[i] + 1]++;
    }
    for (let d = 1; d < starts.length; d++) starts[d] += starts[d - 1];
    for (let i = 0; i < count; i++) next[starts[digits[order[i]]]++] = order[i];
    [order, next] = [next, order];
  }
  return order;
}

/** Points of a file. */
export interface Gaussians {
  count: number;
  /** [N, 3] */
  means: Float32Array;
  /** [N, 4] wxyz, unit */
  quats: Float32Array;
  /** [N, 3] */
  scales: Float32Array;
  /** [N] */
  opacities: Float32Array;
  /** [N, 3], the DC term */
  shBase: Float32Array;
  /** [N] rows of the codebook */
  shRest: Uint16Array | Uint32Array;
  /** [entries, (degree + 1)^2 - 1, 3] */
  codebook: Float32Array;
  shDegree: number;
}

/** Decodes a Draco point cloud to positions [N, 3]. */
export type DecodePoints = (bytes: Uint8Array) => Promise<Float32Array>;

/** Decode the points of a file. */
export async function decodeGaussians(file: Container, decodePoints: DecodePoints): Promise<Gaussians> {
  const count = file.points;
  if (!(Number.isInteger(count) && count >= 0)) throw new ReelError(`it claims ${count} points`);
  if (count === 0) return empty();
  const rest = file.sections.sh_rest
    ? await decodeRest(file, count)
    : { shRest: new Uint16Array(count), codebook: new Float32Array(), shDegree: 0 };
  return {
    count,
    means: await inSection("means", () => decodeMeans(file, count, decodePoints)),
    quats: normalized(await linear(file, "quats", count, 4)),
    scales: await linear(file, "scales", count, 3),
    opacities: await linear(file, "opacities", count, 1),
    shBase: await linear(file, "sh_base", count, 3),
    ...rest,
  };
}

function empty(): Gaussians {
  const none = (): Float32Array => new Float32Array();
  const rest = { shRest: new Uint16Array(), codebook: none(), shDegree: 0 };
  return { count: 0, means: none(), quats: none(), scales: none(), opacities: none(), shBase: none(), ...rest };
}

/** Decode positions. Draco does not keep the order of points, so they are sorted by Morton code, as the encoder did. */
async function decodeMeans(file: Container, count: number, decodePoints: DecodePoints): Promise<Float32Array> {
  const section = sectionOf(file, "means", "draco");
  const low = numbersOf(section, "min", 3);
  const top = 2 ** whole(section, "bits", 4, 21) - 1;
  const { range } = section;
  if (!(typeof range === "number" && range >= 0 && range <= 1e30)) throw new ReelError(`its range is ${short(range)}`);
  const bytes = tensor(file, "means");
  checkDraco(bytes, count);
  const lattice = await decodePoints(bytes);
  if (lattice.length !== 3 * count) throw new ReelError(`it holds ${lattice.length / 3} positions of ${count}`);
  if (!lattice.every((q) => q >= 0 && q <= top && Number.isInteger(q)))
    throw new ReelError("its positions leave their lattice");
  const order = mortonOrder(lattice);
  const step = range / top;
  const means = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    for (let a = 0; a < 3; a++) means[3 * i + a] = low[a] + lattice[3 * order[i] + a] * step;
  }
  return means;
}

/** Reject data that is not a plain point cloud of `count` points, before the decoder allocates memory. */
function checkDraco(bytes: Uint8Array, count: number): void {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const known = bytes.byteLength >= 15 && String.fromCharCode(...bytes.subarray(0, 5)) === "DRACO" && bytes[7] === 0;
  if (!known || view.getUint16(9, true) & 0x8000) throw new ReelError("it is not a plain Draco point cloud");
  const points = view.getInt32(11, true);
  if (points !== count) throw new ReelError(`it is a cloud of ${points} points, expected ${count}`);
}

async function decodeRest(
  file: Container,
  count: number,
): Promise<Pick<Gaussians, "shRest" | "codebook" | "shDegree">> {
  const indices = sectionOf(file, "sh_rest", "vq");
  const entries = await inSection("sh_rest", () => whole(indices, "entries", 1, 65536));
  const bits = await inSection("sh_rest", () => whole(indices, "bits", 1, 16));
  const codebook = sectionOf(file, "sh_codebook", "linear");
  if (codebook.entries !== entries)
    throw new ReelError(`section sh_codebook: it has ${short(codebook.entries)} entries, and sh_rest ${entries}`);
  const shDegree = await inSection("sh_codebook", () => whole(codebook, "degree", 1, 3));
  const shRest = await integers(file, "sh_rest", bits, count);
  if (shRest.some((entry) => entry >= entries))
    throw new ReelError(`section sh_rest: it names a color beyond its codebook of ${entries}`);
  return { shRest, shDegree, codebook: await linear(file, "sh_codebook", entries, 3 * ((shDegree + 1) ** 2 - 1)) };
}

function normalized(quats: Float32Array): Float32Array {
  for (let i = 0; i < quats.length; i += 4) {
    const norm = Math.hypot(quats[i], quats[i + 1], quats[i + 2], quats[i + 3]);
    if (norm > 1e-12) for (let a = 0; a < 4; a++) quats[i + a] /= norm;
    else quats.set([1, 0, 0, 0], i);
  }
  return quats;
}
