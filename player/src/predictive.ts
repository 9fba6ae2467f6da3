/** Points and offsets of the predictive codec: whole numbers back to Gaussians (docs/format.md). */
import type { Container, Section } from "./container";
import { sectionOf, tensor } from "./dequantize";
import { EntropyDecoder, unzigzag } from "./entropy";
import { ReelError, inSection } from "./errors";
import { decodeField, levelsOf, type Levels } from "./field";
import type { Gaussians } from "./gaussians";
import type { Offsets } from "./offsets";

/** Kinds of quantities: a point has a class of each, and steps of 2^class. */
const SHAPE = 0;
export const COLOR = 1;
const MOTION = 2;

/** What decoding the values of points needs to know of them. */
export interface Neighbourhood {
  levels: Levels;
  /** [3][N] */
  classes: Uint8Array[];
}

export async function decodePredictive(file: Container): Promise<{ points: Gaussians; here: Neighbourhood }> {
  const count = file.points;
  const { means, lattice } = await inSection("means", () => decodeMeans(file, count));
  const levels = levelsOf(lattice);
  const flat = { levels, classes: [new Uint8Array(count)] };
  const relative = await values(file, "classes", 0, 3, flat);
  const classes = relative.map((column, kind) => {
    const whole = kind === SHAPE ? column : column.map((value, i) => value + relative[SHAPE][i]);
    if (!whole.every((value) => value >= 0 && value <= 7)) throw new ReelError("section classes: it has classes outside 0 to 7");
    return Uint8Array.from(whole);
  });
  const here = { levels, classes };
  const xyz = await values(file, "quats", SHAPE, 3, here);
  const logs = await values(file, "scales", SHAPE, 3, here);
  const [opacity] = await values(file, "opacities", SHAPE, 1, here);
  const color = await values(file, "sh_base", COLOR, 3, here);
  const rest = file.sections.sh_rest ? await decodeRest(file, here) : { shRest: new Uint32Array(count), codebook: new Float32Array(), shDegree: 0 };
  const quats = new Float32Array(4 * count);
  const scales = new Float32Array(3 * count);
  const shBase = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const [x, y, z] = [xyz[0][i], xyz[1][i], xyz[2][i]];
    const w = Math.sqrt(Math.max(1 - (x * x + y * y + z * z), 0));
    const norm = Math.hypot(w, x, y, z);
    quats.set([w / norm, x / norm, y / norm, z / norm], 4 * i);
    for (let a = 0; a < 3; a++) scales[3 * i + a] = 2 ** Math.min(Math.max(logs[a][i], -126), 126);
    const [bright, red, green] = [color[0][i] / Math.sqrt(3), color[1][i] / Math.sqrt(2), color[2][i] / Math.sqrt(6)];
    shBase.set([bright + red - green, bright + 2 * green, bright - red - green], 3 * i);
  }
  const opacities = Float32Array.from(opacity, (value) => Math.min(Math.max(value, 0), 1));
  return { points: { count, means, quats, scales, opacities, shBase, ...rest }, here };
}

/** Offsets [T] at the frames, as whole numbers over their own ranges: see `Offsets`. */
export async function decodeMotion(file: Container, here: Neighbourhood): Promise<Omit<Offsets, "shade">> {
  const frames = file.frames;
  if (!(Number.isInteger(frames) && frames >= 1 && frames * file.points <= 2 ** 26)) throw new ReelError(`it claims ${frames} frames`);
  const dx = await inSection("dx", () => transformed(file, "dx", MOTION, frames, 3, here));
  const turns = await inSection("dq", () => transformed(file, "dq", MOTION, frames, 3, here));
  const dq = new Float32Array(4 * frames * file.points);
  for (let i = 0; i < frames * file.points; i++) {
    const x = turns[3 * i];
    const y = turns[3 * i + 1];
    const z = turns[3 * i + 2];
    const angle = Math.sqrt(x * x + y * y + z * z);
    const share = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
    // q and -q turn alike, and of neighbouring frames the nearer ones are to be blended: the sign follows the vector.
    dq[4 * i] = Math.cos(angle / 2);
    dq[4 * i + 1] = x * share;
    dq[4 * i + 2] = y * share;
    dq[4 * i + 3] = z * share;
  }
  const x = wholes(dx, 3, new Uint16Array(4 * frames * file.points), 65535);
  const q = wholes(dq, 4, new Uint8Array(4 * frames * file.points), 255);
  return { frames, dx: x.data, dxMin: x.min, dxStep: x.step, dq: q.data, dqMin: q.min, dqStep: q.step };
}

async function decodeMeans(file: Container, count: number): Promise<{ means: Float32Array; lattice: Float64Array }> {
  const section = sectionOf(file, "means", "lattice");
  const low = section.min as number[];
  const step = stepOf(section);
  if (!Array.isArray(low) || low.length !== 3 || !low.every(Number.isFinite)) throw new ReelError("its positions have no origin");
  const decoder = await EntropyDecoder.open(tensor(file, "means"), 1);
  const lattice = new Float64Array(3 * count);
  const means = new Float32Array(3 * count);
  let code = 0;
  decoder.begin();
  for (let i = 0; i < count; i++) {
    code += decoder.next(0);
    if (code >= 2 ** 51) throw new ReelError("its positions leave their lattice");
    const high = Math.floor(code / 2 ** 24);
    for (let a = 0; a < 3; a++) {
      const q = everyThird(code % 2 ** 24, a) + 256 * everyThird(high, a);
      lattice[3 * i + a] = q;
      means[3 * i + a] = low[a] + q * step;
    }
  }
  decoder.finish();
  return { means, lattice };
}

/** Bits a, a + 3, a + 6, ... of a number of at most 27 bits. */
function everyThird(code: number, a: number): number {
  let result = 0;
  for (let bit = 0; 3 * bit + a < 27; bit++) result |= ((code >> (3 * bit + a)) & 1) << bit;
  return result;
}

async function decodeRest(file: Container, here: Neighbourhood): Promise<Pick<Gaussians, "shRest" | "codebook" | "shDegree">> {
  const shDegree = sectionOf(file, "sh_rest", "klt").degree as number;
  if (![1, 2, 3].includes(shDegree)) throw new ReelError(`it has spherical harmonics of degree ${shDegree}`);
  const size = 3 * ((shDegree + 1) ** 2 - 1);
  const codebook = await inSection("sh_rest", () => transformed(file, "sh_rest", COLOR, size, 1, here));
  // [D, N] to one row a point: every point is an entry of its own.
  const rows = new Float32Array(codebook.length);
  for (let d = 0; d < size; d++) for (let i = 0; i < file.points; i++) rows[i * size + d] = codebook[d * file.points + i];
  return { shRest: Uint32Array.from({ length: file.points }, (_, i) => i), codebook: rows, shDegree };
}

/** Values [columns][N] of a `field` section. */
async function values(file: Container, name: string, kind: number, columns: number, here: Neighbourhood): Promise<Float64Array[]> {
  const section = sectionOf(file, name, "field");
  return inSection(name, async () => {
    const step = stepOf(section);
    const whole = await decodeField(tensor(file, name), columns, here.levels, here.classes[kind]);
    return whole.map((column) => Float64Array.from(column, (value) => value * step));
  });
}

/** Values [D, N, channels] of a `klt` section whose basis has D dimensions. */
export async function transformed(file: Container, name: string, kind: number, dimensions: number, channels: number, here: Neighbourhood): Promise<Float32Array> {
  const section = sectionOf(file, name, "klt");
  const step = stepOf(section);
  const data = tensor(file, name);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const head = data.byteLength < 8 ? NaN : view.getUint32(0, true);
  if (Number.isNaN(head) || 8 + head + view.getUint32(4, true) !== data.byteLength) throw new ReelError("it does not hold its streams");
  const basis = await decodeBasis(data.subarray(8, 8 + head), section, dimensions);
  const whole = await decodeField(data.subarray(8 + head), basis.length * channels, here.levels, here.classes[kind]);
  const result = new Float32Array(dimensions * file.points * channels);
  const sums = new Float64Array(file.points);
  for (let d = 0; d < dimensions; d++) {
    for (let c = 0; c < channels; c++) {
      sums.fill(0);
      basis.forEach((column, k) => {
        const weight = column[d] * step;
        const coefficients = whole[k * channels + c];
        if (weight !== 0) for (let i = 0; i < sums.length; i++) sums[i] += weight * coefficients[i];
      });
      for (let i = 0; i < sums.length; i++) result[(d * file.points + i) * channels + c] = sums[i];
    }
  }
  return result;
}

function stepOf(section: Section): number {
  const step = section.step;
  if (!(typeof step === "number" && step >= 1e-30 && step <= 1e30)) throw new ReelError(`it has steps of ${JSON.stringify(step)}`);
  return step;
}

/** Basis vectors [K][D]. */
async function decodeBasis(data: Uint8Array, section: Section, dimensions: number): Promise<Float64Array[]> {
  const shifts = section.shifts as number[];
  if (!Array.isArray(shifts) || shifts.length < 1 || shifts.length > dimensions || !shifts.every((s) => s >= 0 && s <= 20)) throw new ReelError("it has a basis of the wrong size");
  const decoder = await EntropyDecoder.open(data, 1);
  decoder.begin();
  const basis = shifts.map((shift) => Float64Array.from({ length: dimensions }, () => unzigzag(decoder.next(0)) * 2 ** -shift));
  decoder.finish();
  return basis;
}

/** Numbers [M, channels] as whole numbers [M, 4] of 0 to `steps` over each channel's range. */
export function wholes<A extends Uint16Array | Uint8Array>(from: Float32Array, channels: number, data: A, steps: number): { data: A; min: number[]; step: number[] } {
  const min = new Array<number>(channels).fill(Infinity);
  const max = new Array<number>(channels).fill(-Infinity);
  for (let i = 0; i < from.length; i++) {
    const c = i % channels;
    if (from[i] < min[c]) min[c] = from[i];
    if (from[i] > max[c]) max[c] = from[i];
  }
  const step = min.map((low, c) => (max[c] - low) / steps);
  for (let i = 0, to = 0; i < from.length; to += 4) {
    for (let c = 0; c < channels; c++, i++) data[to + c] = step[c] > 0 ? Math.round((from[i] - min[c]) / step[c]) : 0;
  }
  return { data, min, step };
}
