/** Points and offsets of the predictive codec: whole numbers back to Gaussians (docs/format.md). */
import type { Container, Section } from "./container";
import { sectionOf, tensor } from "./dequantize";
import { EntropyDecoder, unzigzag } from "./entropy";
import { ReelError, inSection } from "./errors";
import type { Levels } from "./field";
import type { Gaussians } from "./gaussians";
import type { Kernels } from "./kernels";
import { coded, primaries, type Form, type Klt } from "./klt";
import type { Offsets } from "./offsets";

/** Kinds of quantities: a point has a class of each, and steps of 2^class. */
const SHAPE = 0;
export const COLOR = 1;
const MOTION = 2;
/** Numbers of a basis, K D, at most. */
const MOST_BASIS = 2 ** 20;
const MOVES: Form = { turn: "nothing", rest: [0, 0, 0, 0], most: 65535 };
const TURNS: Form = { turn: "quaternion", rest: [1, 0, 0, 0], most: 255 };

/** What decoding the values of points needs to know of them. */
export interface Neighbourhood {
  levels: Levels;
  /** [3][N] */
  classes: Uint8Array[];
  kernels: Kernels;
}

export async function decodePredictive(file: Container, kernels: Kernels): Promise<{ points: Gaussians; here: Neighbourhood }> {
  const count = file.points;
  const { means, lattice } = await inSection("means", () => decodeMeans(file, count));
  const levels = kernels.levelsOf(lattice);
  const here = { levels, classes: await decodeClasses(file, levels, kernels), kernels };
  const xyz = await values(file, "quats", SHAPE, 3, here);
  const scales = await values(file, "scales", SHAPE, 3, here);
  const opacities = await values(file, "opacities", SHAPE, 1, here);
  const shBase = await values(file, "sh_base", COLOR, 3, here);
  const rest = file.sections.sh_rest ? await decodeRest(file, here) : { shRest: new Uint32Array(count), codebook: new Float32Array(), shDegree: 0 };
  const quats = new Float32Array(4 * count);
  for (let i = 0, t = 0, f = 0; i < count; i++, t += 3, f += 4) {
    const x = xyz[t];
    const y = xyz[t + 1];
    const z = xyz[t + 2];
    const square = x * x + y * y + z * z;
    const w = Math.sqrt(Math.max(1 - square, 0));
    const norm = Math.sqrt(w * w + square);
    quats[f] = w / norm;
    quats[f + 1] = x / norm;
    quats[f + 2] = y / norm;
    quats[f + 3] = z / norm;
    for (let a = t; a < t + 3; a++) scales[a] = 2 ** Math.min(Math.max(scales[a], -126), 126);
    primaries(shBase, t);
    opacities[i] = Math.min(Math.max(opacities[i], 0), 1);
  }
  const plain = { means, quats, scales: new Float32Array(scales), opacities: new Float32Array(opacities), shBase: new Float32Array(shBase) };
  return { points: { count, ...plain, ...rest }, here };
}

/** Offsets [T] at the frames, as whole numbers over their own ranges: see `Offsets`. */
export async function decodeMotion(file: Container, here: Neighbourhood): Promise<Omit<Offsets, "shade">> {
  const { frames, points: count } = file;
  if (!(Number.isInteger(frames) && frames >= 1 && frames * count <= 2 ** 26)) throw new ReelError(`it claims ${frames} frames`);
  const moves = await inSection("dx", () => here.kernels.decodeTexture(kltOf(file, "dx", MOTION, frames, 3, here), MOVES));
  const turns = await inSection("dq", () => here.kernels.decodeTexture(kltOf(file, "dq", MOTION, frames, 3, here), TURNS));
  return {
    frames,
    dx: moves.data as Uint16Array,
    dxMin: moves.min.slice(0, 3),
    dxStep: moves.step.slice(0, 3),
    dq: turns.data as Uint8Array,
    dqMin: turns.min,
    dqStep: turns.step,
  };
}

function decodeMeans(file: Container, count: number): { means: Float32Array; lattice: Float64Array } {
  const section = sectionOf(file, "means", "lattice");
  const low = section.min as number[];
  const step = stepOf(section);
  if (!Array.isArray(low) || low.length !== 3 || !low.every(Number.isFinite)) throw new ReelError("its positions have no origin");
  const decoder = new EntropyDecoder(tensor(file, "means"), 1);
  const lattice = new Float64Array(3 * count);
  const means = new Float32Array(3 * count);
  let code = 0;
  for (let i = 0; i < count; i++) {
    code += decoder.nextLarge(0);
    if (code >= 2 ** 51) throw new ReelError("its positions leave their lattice");
    const high = Math.floor(code / 2 ** 24);
    const rest = code - high * 2 ** 24;
    for (let a = 0; a < 3; a++) {
      const q = everyThird(rest >> a) | (everyThird(high >> a) << 8);
      lattice[3 * i + a] = q;
      means[3 * i + a] = low[a] + q * step;
    }
  }
  decoder.finish();
  return { means, lattice };
}

/** Bits 0, 3, 6, ... of a number of at most 27 bits. */
function everyThird(code: number): number {
  let bits = code & 0x1249249;
  bits = (bits | (bits >> 2)) & 0x10c30c3;
  bits = (bits | (bits >> 4)) & 0x100f00f;
  bits = (bits | (bits >> 8)) & 0x10000ff;
  return (bits | (bits >> 16)) & 0x1ff;
}

async function decodeClasses(file: Container, levels: Levels, kernels: Kernels): Promise<Uint8Array[]> {
  const count = file.points;
  const relative = await values(file, "classes", 0, 3, { levels, classes: [new Uint8Array(count)], kernels });
  const classes = [SHAPE, COLOR, MOTION].map(() => new Uint8Array(count));
  for (let i = 0; i < count; i++) {
    for (const kind of [SHAPE, COLOR, MOTION]) {
      const value = relative[3 * i + kind] + (kind === SHAPE ? 0 : relative[3 * i]);
      if (!(value >= 0 && value <= 7)) throw new ReelError("section classes: it has classes outside 0 to 7");
      classes[kind][i] = value;
    }
  }
  return classes;
}

async function decodeRest(file: Container, here: Neighbourhood): Promise<Pick<Gaussians, "shRest" | "codebook" | "shDegree">> {
  const shDegree = sectionOf(file, "sh_rest", "klt").degree as number;
  if (![1, 2, 3].includes(shDegree)) throw new ReelError(`it has spherical harmonics of degree ${shDegree}`);
  const size = 3 * ((shDegree + 1) ** 2 - 1);
  const rest = await inSection("sh_rest", () => {
    const klt = kltOf(file, "sh_rest", COLOR, size, 1, here);
    return { points: coded(klt.ends), rows: here.kernels.decodeRows(klt) };
  });
  // Points without coefficients share the first entry, which is zero; the others have an entry each.
  const shRest = new Uint32Array(file.points);
  rest.points.forEach((point, entry) => (shRest[point] = entry + 1));
  const codebook = new Float32Array(size + rest.rows.length);
  codebook.set(rest.rows, size);
  return { shRest, codebook, shDegree };
}

/** Values [N, columns] of a `field` section. */
function values(file: Container, name: string, kind: number, columns: number, here: Neighbourhood): Promise<Float64Array> {
  const section = sectionOf(file, name, "field");
  return inSection(name, () => {
    const step = stepOf(section);
    const result = new Float64Array(here.kernels.decodeField(tensor(file, name), columns, here.levels, here.classes[kind]));
    for (let i = 0; i < result.length; i++) result[i] *= step;
    return result;
  });
}

/** A `klt` section of D dimensions, its basis and ends decoded. */
export function kltOf(file: Container, name: string, kind: number, dimensions: number, channels: number, here: Neighbourhood): Klt {
  const section = sectionOf(file, name, "klt");
  const step = stepOf(section);
  const data = tensor(file, name);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const sizes = data.byteLength < 12 ? [NaN] : [0, 4, 8].map((at) => view.getUint32(at, true));
  if (sizes.reduce((sum, size) => sum + size, 12) !== data.byteLength) throw new ReelError("it does not hold its streams");
  const [first, second] = [12 + sizes[0], 12 + sizes[0] + sizes[1]];
  const columns = decodeBasis(data.subarray(12, first), section, dimensions);
  const ends = here.kernels.decodeField(data.subarray(first, second), 1, here.levels, new Uint8Array(file.points));
  const most = columns.length * channels;
  if (!ends.every((end) => end >= 0 && end <= most)) throw new ReelError(`it has points of more columns than ${most}`);
  const basis = new Float64Array(dimensions * columns.length);
  columns.forEach((column, k) => column.forEach((value, d) => (basis[d * columns.length + k] = value * step)));
  return { data: data.subarray(second), ends, channels, basis, dimensions, levels: here.levels, shifts: here.classes[kind] };
}

function stepOf(section: Section): number {
  const step = section.step;
  if (!(typeof step === "number" && step >= 1e-30 && step <= 1e30)) throw new ReelError(`it has steps of ${JSON.stringify(step)}`);
  return step;
}

/** Basis vectors [K][D]. */
function decodeBasis(data: Uint8Array, section: Section, dimensions: number): Float64Array[] {
  const shifts = section.shifts as number[];
  if (!Array.isArray(shifts) || shifts.length < 1 || shifts.length > dimensions || !shifts.every((s) => s >= 0 && s <= 20)) throw new ReelError("it has a basis of the wrong size");
  // One of zeros takes no bytes, however large it claims to be.
  if (shifts.length * dimensions > MOST_BASIS) throw new ReelError(`it has a basis of ${shifts.length} x ${dimensions} numbers`);
  const decoder = new EntropyDecoder(data, 1);
  const basis = shifts.map((shift) => Float64Array.from({ length: dimensions }, () => unzigzag(decoder.next(0)) * 2 ** -shift));
  decoder.finish();
  return basis;
}
