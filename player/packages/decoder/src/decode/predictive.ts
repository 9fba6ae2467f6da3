/** Decoding of points and offsets of the predictive codec (docs/format.md). */
import { inSection, ReelError } from "../base/errors";
import type { Container, Section } from "../reel/container";
import { sectionOf, tensor } from "./dequantize";
import { EntropyDecoder, unzigzag } from "./entropy";
import type { Gaussians } from "./gaussians";
import type { Kernels } from "./kernels";
import { coded, type Form, type Klt, primaries } from "./klt";
import type { Levels } from "./lod-prediction";
import type { Offsets } from "./offsets";

const LARGEST = 126;
const SWEEPS = 12;
const NOTHING = 1e-18;
const ROOT2 = Math.sqrt(2);
const ROOT6 = Math.sqrt(6);

/** Scratch memory: a symmetric matrix xx, xy, xz, yy, yz, zz and a quaternion wxyz. */
const m = new Float64Array(6);
const q = new Float64Array(4);
const [XX, XY, XZ, YY, YZ, ZZ] = [0, 1, 2, 3, 4, 5];
const [X, Y, Z] = [1, 2, 3];

/** Convert numbers [N, 6] to unit quaternions [N, 4] and scales [N, 3]. Python computes exactly the same rotations. */
function toShapes(numbers: Float64Array): { quats: Float32Array; scales: Float32Array } {
  const count = numbers.length / 6;
  const quats = new Float32Array(4 * count);
  const scales = new Float32Array(3 * count);
  for (let i = 0, n = 0; i < count; i++, n += 6) {
    const size = numbers[n] / ROOT6;
    const across = numbers[n + 1] / ROOT2;
    const along = numbers[n + 2] / ROOT6;
    m[XX] = size - along + across;
    m[YY] = size - along - across;
    m[ZZ] = size + 2 * along;
    m[XY] = numbers[n + 3] / ROOT2;
    m[XZ] = numbers[n + 4] / ROOT2;
    m[YZ] = numbers[n + 5] / ROOT2;
    q.fill(0);
    q[0] = 1;
    diagonalize();
    const norm = Math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (let k = 0; k < 4; k++) quats[4 * i + k] = q[k] / norm;
    scales[3 * i] = power(m[XX]);
    scales[3 * i + 1] = power(m[YY]);
    scales[3 * i + 2] = power(m[ZZ]);
  }
  return { quats, scales };
}

function power(octaves: number): number {
  return 2 ** Math.min(Math.max(octaves, -LARGEST), LARGEST);
}

/** Diagonalize `m` by Jacobi rotations, which accumulate in `q`. */
function diagonalize(): void {
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    const rest = m[XY] * m[XY] + m[XZ] * m[XZ] + m[YZ] * m[YZ];
    const whole = m[XX] * m[XX] + m[YY] * m[YY] + m[ZZ] * m[ZZ];
    if (rest <= NOTHING * whole) return;
    turn(XX, YY, XY, XZ, YZ, X, Y, Z);
    turn(ZZ, XX, XZ, YZ, XY, Z, X, Y);
    turn(YY, ZZ, YZ, XY, XZ, Y, Z, X);
  }
}

/** Rotate about axis c so that `m` is zero at axes a and b. The arguments are the indices of these axes in `m` and `q`. */
function turn(aa: number, bb: number, ab: number, ac: number, bc: number, a: number, b: number, c: number): void {
  const off = m[ab];
  if (off === 0) return;
  const half = (m[bb] - m[aa]) / (2 * off);
  let tangent = 1 / (Math.abs(half) + Math.sqrt(half * half + 1));
  if (half < 0) tangent = -tangent;
  const cosine = 1 / Math.sqrt(tangent * tangent + 1);
  const sine = tangent * cosine;
  m[aa] -= tangent * off;
  m[bb] += tangent * off;
  m[ab] = 0;
  const x = m[ac];
  const y = m[bc];
  m[ac] = cosine * x - sine * y;
  m[bc] = sine * x + cosine * y;
  const w = Math.sqrt((1 + cosine) / 2);
  const v = -sine / (2 * w);
  const qw = q[0];
  const qa = q[a];
  const qb = q[b];
  const qc = q[c];
  q[0] = w * qw - v * qc;
  q[a] = w * qa + v * qb;
  q[b] = w * qb - v * qa;
  q[c] = w * qc + v * qw;
}

/** Kinds of values. A point has a class of each kind, and steps of 2^class. */
const SHAPE = 0;
export const COLOR = 1;
const MOTION = 2;
/** Maximum number of values of a basis. */
const MAX_BASIS = 2 ** 20;
const MOVES: Form = { turn: "nothing", rest: [0, 0, 0, 0], most: 65535 };
const TURNS: Form = { turn: "quaternion", rest: [1, 0, 0, 0], most: 255 };

/** Neighbors and classes of the points, by which their values are decoded. */
export interface Neighborhood {
  levels: Levels;
  /** [3][N] */
  classes: Uint8Array[];
  kernels: Kernels;
}

/** Decode the points of a file. */
export async function decodePredictive(
  file: Container,
  kernels: Kernels,
): Promise<{ points: Gaussians; here: Neighborhood }> {
  const count = file.points;
  const { quantized, ...cells } = await inSection("means", () => decodeQuantizedPositions(file, count));
  const levels = kernels.levelsOf(quantized);
  const here = { levels, classes: await decodeClasses(file, levels, kernels), kernels };
  const means = await inSection("places", () => decodeRefinementBits(file, quantized, cells, here.classes[MOTION]));
  const { quats, scales } = toShapes(await values(file, "shapes", SHAPE, 6, here));
  const opacities = await values(file, "opacities", SHAPE, 1, here);
  const shBase = await values(file, "sh_base", COLOR, 3, here);
  const rest = file.sections.sh_rest
    ? await decodeRest(file, here)
    : { shRest: new Uint32Array(count), codebook: new Float32Array(), shDegree: 0 };
  for (let i = 0; i < count; i++) {
    primaries(shBase, 3 * i);
    opacities[i] = Math.min(Math.max(opacities[i], 0), 1);
  }
  const plain = { means, quats, scales, opacities: new Float32Array(opacities), shBase: new Float32Array(shBase) };
  return { points: { count, ...plain, ...rest }, here };
}

/** Decode the motion of a group, see `Offsets`. */
export async function decodeMotion(file: Container, here: Neighborhood): Promise<Omit<Offsets, "appearance">> {
  const { frames, points: count } = file;
  if (!(Number.isInteger(frames) && frames >= 1 && frames * count <= 2 ** 26))
    throw new ReelError(`it claims ${frames} frames`);
  const moves = await inSection("dx", () =>
    here.kernels.decodeTexture(kltOf(file, "dx", MOTION, frames, 3, here), MOVES),
  );
  const turns = await inSection("dq", () =>
    here.kernels.decodeTexture(kltOf(file, "dq", MOTION, frames, 3, here), TURNS),
  );
  return {
    frames,
    dx: moves.data as Uint16Array,
    dxMin: moves.min.slice(0, 3),
    dxStep: moves.step.slice(0, 3),
    dq: turns.data as Uint8Array,
    dqMin: turns.min,
    dqStep: turns.step,
    worldly: true,
  };
}

/** Lattice of the quantized positions: origin `low`, cell size `step`, and additional bits of the finest points. */
interface Cells {
  low: number[];
  step: number;
  finer: number;
}

function decodeQuantizedPositions(file: Container, count: number): Cells & { quantized: Float64Array } {
  const section = sectionOf(file, "means", "lattice");
  const low = section.min as number[];
  const finer = section.finer as number;
  const step = stepOf(section);
  if (!(Number.isInteger(finer) && finer >= 0 && finer <= 7))
    throw new ReelError(`its points have ${JSON.stringify(finer)} bits more`);
  if (!Array.isArray(low) || low.length !== 3 || !low.every(Number.isFinite))
    throw new ReelError("its positions have no origin");
  const decoder = new EntropyDecoder(tensor(file, "means"), 1);
  const quantized = new Float64Array(3 * count);
  let code = 0;
  for (let i = 0; i < count; i++) {
    code += decoder.nextLarge(0);
    if (code >= 2 ** 51) throw new ReelError("its positions leave their lattice");
    const high = Math.floor(code / 2 ** 24);
    const rest = code - high * 2 ** 24;
    for (let a = 0; a < 3; a++) quantized[3 * i + a] = everyThird(rest >> a) | (everyThird(high >> a) << 8);
  }
  decoder.finish();
  return { quantized, low, step, finer };
}

/** Positions [N, 3]: a point of class c has `finer` - c bits along each axis for its place in its cell, the lowest ones of all points first. */
function decodeRefinementBits(
  file: Container,
  quantized: Float64Array,
  { low, step, finer }: Cells,
  classes: Uint8Array,
): Float32Array {
  sectionOf(file, "places", "plain");
  const data = tensor(file, "places");
  let total = 0;
  for (const kind of classes) total += 3 * Math.max(finer - kind, 0);
  if (data.length !== (total + 7) >> 3)
    throw new ReelError(`it holds ${data.length} bytes where its points have ${total} bits`);
  const refinement = new Uint8Array(quantized.length);
  for (let b = 0, bit = 0; b < finer; b++) {
    for (let i = 0; i < classes.length; i++) {
      if (finer - classes[i] <= b) continue;
      for (let at = 3 * i; at < 3 * i + 3; at++, bit++) refinement[at] |= ((data[bit >> 3] >> (bit & 7)) & 1) << b;
    }
  }
  const means = new Float32Array(quantized.length);
  for (let i = 0, at = 0; i < classes.length; i++) {
    const parts = 2 ** Math.max(finer - classes[i], 0);
    for (let a = 0; a < 3; a++, at++)
      means[at] = low[a] + (quantized[at] + (2 * refinement[at] + 1 - parts) / (2 * parts)) * step;
  }
  return means;
}

/** Return bits 0, 3, 6, ... of a number of at most 27 bits. */
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

async function decodeRest(
  file: Container,
  here: Neighborhood,
): Promise<Pick<Gaussians, "shRest" | "codebook" | "shDegree">> {
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

/** Decode the values [N, columns] of a `field` section. */
function values(
  file: Container,
  name: string,
  kind: number,
  columns: number,
  here: Neighborhood,
): Promise<Float64Array> {
  const section = sectionOf(file, name, "field");
  return inSection(name, () => {
    const step = stepOf(section);
    const result = new Float64Array(
      here.kernels.decodeLod(tensor(file, name), columns, here.levels, here.classes[kind]),
    );
    for (let i = 0; i < result.length; i++) result[i] *= step;
    return result;
  });
}

/** Parse a `klt` section of D dimensions, and decode its basis and ends. */
export function kltOf(
  file: Container,
  name: string,
  kind: number,
  dimensions: number,
  channels: number,
  here: Neighborhood,
): Klt {
  const section = sectionOf(file, name, "klt");
  const step = stepOf(section);
  const data = tensor(file, name);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const sizes = data.byteLength < 16 ? [NaN] : [0, 4, 8, 12].map((at) => view.getUint32(at, true));
  if (sizes.reduce((sum, size) => sum + size, 16) !== data.byteLength)
    throw new ReelError("it does not hold its streams");
  let cut = 16;
  const [basisData, columnsData, endsData, body] = sizes.map((size) => data.subarray(cut, (cut += size)));
  const vectors = decodeBasis(basisData, section, dimensions);
  const columns = decodeColumns(columnsData, section, vectors.length, channels);
  const ends = here.kernels.decodeLod(endsData, 1, here.levels, new Uint8Array(file.points));
  if (!ends.every((end) => end >= 0 && end <= columns.length))
    throw new ReelError(`it has points of more columns than ${columns.length}`);
  const basis = new Float64Array(dimensions * vectors.length);
  vectors.forEach((vector, k) => vector.forEach((value, d) => (basis[d * vectors.length + k] = value * step)));
  return { data: body, ends, columns, channels, basis, dimensions, levels: here.levels, shifts: here.classes[kind] };
}

/** Decode the channel of each column. No channel has more columns than the basis has vectors. */
function decodeColumns(data: Uint8Array, section: Section, vectors: number, channels: number): Uint8Array {
  const count = section.columns as number;
  if (!(Number.isInteger(count) && count >= 1 && count <= vectors * channels))
    throw new ReelError(`it has ${JSON.stringify(count)} columns`);
  const decoder = new EntropyDecoder(data, 1);
  const used = new Int32Array(channels);
  const columns = Uint8Array.from({ length: count }, () => {
    const channel = decoder.next(0);
    if (!(channel < channels && used[channel]++ < vectors)) throw new ReelError("it has columns of other channels");
    return channel;
  });
  decoder.finish();
  return columns;
}

function stepOf(section: Section): number {
  const step = section.step;
  if (!(typeof step === "number" && step >= 1e-30 && step <= 1e30))
    throw new ReelError(`it has steps of ${JSON.stringify(step)}`);
  return step;
}

/** Decode the basis vectors [K][D]. */
function decodeBasis(data: Uint8Array, section: Section, dimensions: number): Float64Array[] {
  const shifts = section.shifts as number[];
  if (
    !Array.isArray(shifts) ||
    shifts.length < 1 ||
    shifts.length > dimensions ||
    !shifts.every((s) => Number.isInteger(s) && s >= 0 && s <= 20)
  )
    throw new ReelError("it has a basis of the wrong size");
  // A basis of zeros takes no bytes, whatever its claimed size.
  if (shifts.length * dimensions > MAX_BASIS)
    throw new ReelError(`it has a basis of ${shifts.length} x ${dimensions} numbers`);
  const decoder = new EntropyDecoder(data, 1);
  const basis = shifts.map((shift) =>
    Float64Array.from({ length: dimensions }, () => unzigzag(decoder.next(0)) * 2 ** -shift),
  );
  decoder.finish();
  return basis;
}
