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
/** Of brightness, red against blue, and green against both in the three colours. */
export const SHARES = [1 / Math.sqrt(3), 1 / Math.sqrt(2), 1 / Math.sqrt(6)];

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
  const here = { levels, classes: await decodeClasses(file, levels) };
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
    const bright = shBase[t] * SHARES[0];
    const red = shBase[t + 1] * SHARES[1];
    const green = shBase[t + 2] * SHARES[2];
    shBase[t] = bright + red - green;
    shBase[t + 1] = bright + 2 * green;
    shBase[t + 2] = bright - red - green;
    opacities[i] = Math.min(Math.max(opacities[i], 0), 1);
  }
  const plain = { means, quats, scales: Float32Array.from(scales), opacities: Float32Array.from(opacities), shBase: Float32Array.from(shBase) };
  return { points: { count, ...plain, ...rest }, here };
}

/** Offsets [T] at the frames, as whole numbers over their own ranges: see `Offsets`. */
export async function decodeMotion(file: Container, here: Neighbourhood): Promise<Omit<Offsets, "shade">> {
  const { frames, points: count } = file;
  if (!(Number.isInteger(frames) && frames >= 1 && frames * count <= 2 ** 26)) throw new ReelError(`it claims ${frames} frames`);
  const moves = await inSection("dx", () => transformed(file, "dx", MOTION, frames, 3, here));
  const turns = await inSection("dq", () => transformed(file, "dq", MOTION, frames, 3, here));
  const all = Uint32Array.from({ length: count }, (_, i) => i);
  const turning = all.filter((i) => turns.ends[i] > 0);
  const dx = new Uint16Array(4 * frames * count);
  const x = wholes(curves(moves, all, 3), 3, [], all, dx, 65535);
  const dq = new Uint8Array(4 * frames * count);
  const q = wholes(quaternions(curves(turns, turning, 3)), 4, [1, 0, 0, 0], turning, dq, 255);
  return { frames, dx, dxMin: x.min, dxStep: x.step, dq, dqMin: q.min, dqStep: q.step };
}

/** Quaternions [M, 4] of rotation vectors [M, 3]. */
function quaternions(turns: Float32Array): Float32Array {
  const result = new Float32Array((turns.length / 3) * 4);
  for (let from = 0, to = 0; from < turns.length; from += 3, to += 4) {
    const x = turns[from];
    const y = turns[from + 1];
    const z = turns[from + 2];
    const angle = Math.sqrt(x * x + y * y + z * z);
    const share = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
    // q and -q turn alike, and of neighbouring frames the nearer ones are to be blended: the sign follows the vector.
    result[to] = Math.cos(angle / 2);
    result[to + 1] = x * share;
    result[to + 2] = y * share;
    result[to + 3] = z * share;
  }
  return result;
}

/**
 * Numbers [T, points, channels] as whole ones of 0 to `steps` over each channel's range, into data [T, N, 4]. rest: what the points of N
 * have that are not among `points`.
 */
export function wholes(from: Float32Array, channels: number, rest: number[], points: Uint32Array, data: Uint16Array | Uint8Array, steps: number): { min: number[]; step: number[] } {
  const row = channels * points.length;
  const frames = row > 0 ? from.length / row : 0;
  const stride = data.length / Math.max(frames, 1);
  const low = Array.from({ length: channels }, (_, c) => rest[c] ?? Infinity);
  const high = Array.from({ length: channels }, (_, c) => rest[c] ?? -Infinity);
  // Frame by frame: what is read of one for the first channel is still at hand for the last.
  for (let t = 0; t < frames; t++) {
    for (let c = 0; c < channels; c++) {
      let least = low[c];
      let most = high[c];
      for (let i = t * row + c; i < (t + 1) * row; i += channels) {
        const value = from[i];
        if (value < least) least = value;
        if (value > most) most = value;
      }
      low[c] = least;
      high[c] = most;
    }
  }
  const scale = low.map((least, c) => (high[c] > least ? steps / (high[c] - least) : 0));
  const stay = rest.map((value, c) => Math.round((value - low[c]) * scale[c]));
  if (points.length < stride / 4) for (let to = 0; to < data.length; to++) data[to] = stay[to & 3];
  for (let t = 0; t < frames; t++) {
    for (let c = 0; c < channels; c++) {
      const least = low[c];
      const share = scale[c];
      const start = t * stride + c;
      for (let n = 0, i = t * row + c; n < points.length; n++, i += channels) data[start + 4 * points[n]] = (from[i] - least) * share + 0.5;
    }
  }
  return { min: low, step: low.map((least, c) => (high[c] - least) / steps) };
}

function decodeMeans(file: Container, count: number): { means: Float32Array; lattice: Float64Array } {
  const section = sectionOf(file, "means", "lattice");
  const low = section.min as number[];
  const step = stepOf(section);
  if (!Array.isArray(low) || low.length !== 3 || !low.every(Number.isFinite)) throw new ReelError("its positions have no origin");
  const decoder = EntropyDecoder.open(tensor(file, "means"), 1);
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

async function decodeClasses(file: Container, levels: Levels): Promise<Uint8Array[]> {
  const count = file.points;
  const relative = await values(file, "classes", 0, 3, { levels, classes: [new Uint8Array(count)] });
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
  const rest = await inSection("sh_rest", () => transformed(file, "sh_rest", COLOR, size, 1, here));
  // Points without coefficients share the first entry, which is zero; the others have an entry each.
  const some = Uint32Array.from({ length: file.points }, (_, i) => i).filter((i) => rest.ends[i] > 0);
  const shRest = new Uint32Array(file.points);
  some.forEach((point, entry) => (shRest[point] = entry + 1));
  const codebook = new Float32Array(size * (some.length + 1));
  expand(rest, some, 1, codebook.subarray(size), 1, size);
  return { shRest, codebook, shDegree };
}

/** Values [N, columns] of a `field` section. */
function values(file: Container, name: string, kind: number, columns: number, here: Neighbourhood): Promise<Float64Array> {
  const section = sectionOf(file, name, "field");
  return inSection(name, () => {
    const step = stepOf(section);
    const result = new Float64Array(decodeField(tensor(file, name), columns, here.levels, here.classes[kind]));
    for (let i = 0; i < result.length; i++) result[i] *= step;
    return result;
  });
}

/** What a `klt` section holds: coefficients [N, K channels], of which a point has the first `ends` [N], and their basis [D, K] in world units. */
interface Transformed {
  dimensions: number;
  basis: Float64Array;
  found: Int32Array;
  ends: Int32Array;
}

export function transformed(file: Container, name: string, kind: number, dimensions: number, channels: number, here: Neighbourhood): Transformed {
  const section = sectionOf(file, name, "klt");
  const step = stepOf(section);
  const data = tensor(file, name);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const sizes = data.byteLength < 12 ? [NaN] : [0, 4, 8].map((at) => view.getUint32(at, true));
  if (sizes.reduce((sum, size) => sum + size, 12) !== data.byteLength) throw new ReelError("it does not hold its streams");
  const [first, second] = [12 + sizes[0], 12 + sizes[0] + sizes[1]];
  const columns = decodeBasis(data.subarray(12, first), section, dimensions);
  const ends = decodeField(data.subarray(first, second), 1, here.levels, new Uint8Array(file.points));
  const most = columns.length * channels;
  if (!ends.every((end) => end >= 0 && end <= most)) throw new ReelError(`it has points of more columns than ${most}`);
  const found = decodeField(data.subarray(second), most, here.levels, here.classes[kind], ends);
  const basis = new Float64Array(dimensions * columns.length);
  columns.forEach((column, k) => column.forEach((value, d) => (basis[d * columns.length + k] = value * step)));
  return { dimensions, basis, found, ends };
}

/** Values [D, points, channels] of some of the points. */
export function curves(of: Transformed, points: Uint32Array, channels: number): Float32Array {
  const result = new Float32Array(of.dimensions * points.length * channels);
  expand(of, points, channels, result, points.length * channels, channels);
  return result;
}

/** Values of some of the points: that of dimension d, the n-th of the points and channel c at d across + n along + c. */
function expand({ dimensions, basis, found, ends }: Transformed, points: Uint32Array, channels: number, result: Float32Array, across: number, along: number): void {
  const stride = basis.length / dimensions;
  const own = new Float64Array(channels * stride);
  const last = dimensions - 1;
  for (let n = 0; n < points.length; n++) {
    const used = Math.ceil(ends[points[n]] / channels);
    const from = channels * stride * points[n];
    for (let c = 0; c < channels; c++) for (let k = 0; k < used; k++) own[c * stride + k] = found[from + k * channels + c];
    // Four dimensions at a time: what is read of the point serves all, and no sum waits for another. The last may come twice.
    for (let first = 0; first < dimensions; first += 4) {
      const d = Math.max(Math.min(first, dimensions - 4), 0);
      const [d1, d2, d3] = [Math.min(d + 1, last), Math.min(d + 2, last), Math.min(d + 3, last)];
      for (let c = 0, to = n * along; c < channels; c++, to++) {
        let [s, s1, s2, s3] = [0, 0, 0, 0];
        for (let k = 0, a = d * stride, a1 = d1 * stride, a2 = d2 * stride, a3 = d3 * stride; k < used; k++) {
          const value = own[c * stride + k];
          s += basis[a + k] * value;
          s1 += basis[a1 + k] * value;
          s2 += basis[a2 + k] * value;
          s3 += basis[a3 + k] * value;
        }
        result[d * across + to] = s;
        result[d1 * across + to] = s1;
        result[d2 * across + to] = s2;
        result[d3 * across + to] = s3;
      }
    }
  }
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
  const decoder = EntropyDecoder.open(data, 1);
  const basis = shifts.map((shift) => Float64Array.from({ length: dimensions }, () => unzigzag(decoder.next(0)) * 2 ** -shift));
  decoder.finish();
  return basis;
}
