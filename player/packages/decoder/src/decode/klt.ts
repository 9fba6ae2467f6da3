/** Reconstruction of a `klt` section: sums over its basis, quantized for textures (docs/format.md). */
import { decodeLod, type Levels } from "./lod-prediction";

/** Weights of the color transform: brightness, red minus blue, and green minus both. */
export const SHARES = [1 / Math.sqrt(3), 1 / Math.sqrt(2), 1 / Math.sqrt(6)];

/** A section with its coefficients still encoded. */
export interface Klt {
  /** [N, L] coefficients, encoded as a `field`. Each point has the first `ends` [N] of them. */
  data: Uint8Array;
  ends: Int32Array;
  /** [L] channel of each coefficient. The k-th coefficient of a channel belongs to the k-th basis vector. */
  columns: Uint8Array;
  channels: number;
  /** [D, K], multiplied by the step of the section. */
  basis: Float64Array;
  dimensions: number;
  levels: Levels;
  /** [N] classes of the points, which scale their steps by powers of two. */
  shifts: Uint8Array;
}

/** Conversion of the sums to a texture. rest: value of points without coefficients. */
export interface Form {
  turn: "nothing" | "quaternion" | "color";
  rest: [number, number, number, number];
  /** Largest integer: 255 or 65535. */
  most: number;
}

/** [D, N, 4] integers, which represent min + value * step of their channel. */
export interface Texture<T extends Uint8Array | Uint16Array = Uint8Array | Uint16Array> {
  data: T;
  min: number[];
  step: number[];
}

/** Return the points that have coefficients. */
export function coded(ends: Int32Array): Uint32Array {
  const result = new Uint32Array(ends.length);
  let count = 0;
  for (let i = 0; i < ends.length; i++) if (ends[i] > 0) result[count++] = i;
  return result.slice(0, count);
}

/** Decode the sums [M, D] of one channel, for the M points that have coefficients. */
export function decodeRows(klt: Klt): Float32Array {
  const points = coded(klt.ends);
  const result = new Float32Array(points.length * klt.dimensions);
  expand(klt, points, result, 1, klt.dimensions);
  return result;
}

/** Decode the sums of three or four channels as a texture. */
export function decodeTexture(klt: Klt, form: Form): Texture {
  const points = coded(klt.ends);
  const values = new Float32Array(4 * klt.dimensions * points.length);
  expand(klt, points, values, 4 * points.length, 4);
  if (form.turn === "quaternion") quaternions(values);
  if (form.turn === "color") colors(values);
  return wholes(values, form, points, klt.dimensions, klt.ends.length);
}

/** Return the slot of each coefficient in rows of `across` channels, one row per basis vector, and the number of rows that the first 0 to L coefficients fill. */
export function slotsOf(columns: Uint8Array, across: number): { slots: Int32Array; rows: Int32Array } {
  const slots = new Int32Array(columns.length);
  const rows = new Int32Array(columns.length + 1);
  const vectors = new Int32Array(across);
  columns.forEach((channel, at) => {
    slots[at] = across * vectors[channel]++ + channel;
    rows[at + 1] = Math.max(rows[at], vectors[channel]);
  });
  return { slots, rows };
}

/** Compute the sums. That of dimension d, point n and channel c is stored at d across + n along + c. */
function expand(
  { data, ends, columns, channels, basis, dimensions, levels, shifts }: Klt,
  points: Uint32Array,
  result: Float32Array,
  across: number,
  along: number,
): void {
  const stride = basis.length / dimensions;
  const found = decodeLod(data, columns.length, levels, shifts, ends);
  const { slots, rows } = slotsOf(columns, channels);
  const own = new Float64Array(channels * stride);
  const last = dimensions - 1;
  for (let n = 0; n < points.length; n++) {
    const end = ends[points[n]];
    const used = rows[end];
    const from = columns.length * points[n];
    own.fill(0, 0, channels * used);
    for (let at = 0; at < end; at++) own[slots[at]] = found[from + at];
    // Four dimensions at a time share the reads of a point and have independent sums. The last one may be computed twice.
    for (let first = 0; first < dimensions; first += 4) {
      const d = Math.max(Math.min(first, dimensions - 4), 0);
      const [d1, d2, d3] = [Math.min(d + 1, last), Math.min(d + 2, last), Math.min(d + 3, last)];
      for (let c = 0, to = n * along; c < channels; c++, to++) {
        let [s, s1, s2, s3] = [0, 0, 0, 0];
        for (let k = 0, a = d * stride, a1 = d1 * stride, a2 = d2 * stride, a3 = d3 * stride; k < used; k++) {
          const value = own[k * channels + c];
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

/** Convert rotation vectors (x, y, z, 0) to quaternions (w, x, y, z), in place. */
function quaternions(values: Float32Array): void {
  for (let i = 0; i < values.length; i += 4) {
    const x = values[i];
    const y = values[i + 1];
    const z = values[i + 2];
    const angle = Math.sqrt(x * x + y * y + z * z);
    const share = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
    // q and -q are the same rotation. The sign follows the vector, so that neighboring frames can be blended.
    values[i] = Math.cos(angle / 2);
    values[i + 1] = x * share;
    values[i + 2] = y * share;
    values[i + 3] = z * share;
  }
}

/** Convert (b, r, g) at an index to red, green and blue, in place. */
export function primaries(values: Float32Array | Float64Array, at: number): void {
  const bright = values[at] * SHARES[0];
  const red = values[at + 1] * SHARES[1];
  const green = values[at + 2] * SHARES[2];
  values[at] = bright + red - green;
  values[at + 1] = bright + 2 * green;
  values[at + 2] = bright - red - green;
}

/** Convert (b, r, g, o) to red, green, blue and o / 2, in place. */
function colors(values: Float32Array): void {
  for (let i = 0; i < values.length; i += 4) {
    primaries(values, i);
    values[i + 3] /= 2;
  }
}

/** Quantize values [D, points, 4] over the range of each channel, into rows of `count` points. The other points get the value `rest`. */
function wholes(
  values: Float32Array,
  { rest, most }: Form,
  points: Uint32Array,
  dimensions: number,
  count: number,
): Texture {
  const low = Float64Array.from(rest);
  const high = Float64Array.from(rest);
  for (let i = 0; i < values.length; i++) {
    const value = values[i];
    if (value < low[i & 3]) low[i & 3] = value;
    if (value > high[i & 3]) high[i & 3] = value;
  }
  const { share, stay, step } = scaleOf(low, high, rest, most);
  const data = new (most > 255 ? Uint16Array : Uint8Array)(4 * dimensions * count);
  if (points.length < count) for (let to = 0; to < data.length; to++) data[to] = stay[to & 3];
  for (let d = 0, from = 0; d < dimensions; d++) {
    for (let n = 0; n < points.length; n++, from += 4) {
      const to = 4 * (d * count + points[n]);
      for (let c = 0; c < 4; c++) data[to + c] = (values[from + c] - low[c]) * share[c] + 0.5;
    }
  }
  return { data, min: [...low], step };
}

/** Return the quantization of channels from low to high: steps per unit, the integer of `rest`, and units per step. */
export function scaleOf(
  low: ArrayLike<number>,
  high: ArrayLike<number>,
  rest: number[],
  most: number,
): { share: number[]; stay: number[]; step: number[] } {
  const share = rest.map((_, c) => (high[c] > low[c] ? most / (high[c] - low[c]) : 0));
  return {
    share,
    stay: rest.map((value, c) => Math.round((value - low[c]) * share[c])),
    step: rest.map((_, c) => (high[c] - low[c]) / most),
  };
}
