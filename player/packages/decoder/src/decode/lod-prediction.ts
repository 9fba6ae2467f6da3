/** Integers of points, predicted from nearby points (docs/format.md). Python computes exactly the same. */
import { ReelError } from "../base/errors";
import { EntropyDecoder } from "./entropy";

const FIRST_LEVEL = 64;
const NEIGHBOURS = 4;
const REACH = 8;
const WEIGHT = 4096;
const LIMIT = 2 ** 30;
/** Maximum size of a residual, in eighths of a step. */
const LARGEST = 4095;
/** Maximum stored size of a residual, in steps of class 0. */
const LARGEST_SIZE = 65535;
const EDGES = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 512];
export const CONTEXTS = EDGES.length + 1;
/** Context of each size. */
export const CONTEXT_OF = Uint8Array.from(
  { length: LARGEST + 1 },
  (_, size) => EDGES.filter((edge) => edge <= size).length,
);

/** The order in which points are decoded, and the neighbors that predict each. */
export interface Levels {
  /** [N] points, level by level. */
  order: Uint32Array;
  /** [N, 4] neighbors by position in `order`. Their weights sum to 4096, or to 0 in the first level. */
  neighbours: Uint32Array;
  weights: Uint16Array;
}

/** Return the levels of points at quantized positions [N, 3] in Morton order. */
export function levelsOf(quantized: ArrayLike<number>): Levels {
  const count = quantized.length / 3;
  const order = new Uint32Array(count);
  const neighbours = new Uint32Array(NEIGHBOURS * count);
  const weights = new Uint16Array(NEIGHBOURS * count);
  let stride = firstStride(count);
  let at = 0;
  for (let i = 0; i < count; i += stride) order[at++] = i;
  for (; stride > 1; stride /= 2) {
    for (let i = stride / 2; i < count; i += stride, at++) {
      order[at] = i;
      nearest(quantized, count, i, stride, neighbours, weights, NEIGHBOURS * at);
    }
  }
  return { order, neighbours, weights };
}

/** Return the stride between points of the first level. */
export function firstStride(count: number): number {
  let stride = 1;
  while (Math.floor(count / (2 * stride)) >= FIRST_LEVEL) stride *= 2;
  return stride;
}

const found = new Float64Array(NEIGHBOURS);
const squares = new Float64Array(NEIGHBOURS);
const nearness = new Float64Array(NEIGHBOURS);

/** Find the four nearest of 16 multiples of stride around a point, and weights that decrease with distance. Ties go to the earlier point. */
function nearest(
  quantized: ArrayLike<number>,
  count: number,
  point: number,
  stride: number,
  neighbours: Uint32Array,
  weights: Uint16Array,
  at: number,
): void {
  const middle = Math.floor(point / stride);
  squares.fill(Infinity);
  for (let slot = middle + 1 - REACH; slot <= middle + REACH; slot++) {
    const candidate = slot * stride;
    if (candidate < 0 || candidate >= count) continue;
    let square = 0;
    for (let a = 0; a < 3; a++) square += (quantized[3 * candidate + a] - quantized[3 * point + a]) ** 2;
    let place = NEIGHBOURS;
    while (place > 0 && square < squares[place - 1]) place--;
    for (let i = NEIGHBOURS - 1; i > place; i--) {
      squares[i] = squares[i - 1];
      found[i] = found[i - 1];
    }
    if (place < NEIGHBOURS) {
      squares[place] = square;
      found[place] = candidate;
    }
  }
  for (let i = 0; i < NEIGHBOURS; i++) nearness[i] = squares[i] < Infinity ? 1 / (1 + Math.sqrt(squares[i])) : 0;
  const total = nearness[0] + nearness[1] + nearness[2] + nearness[3];
  let rest = WEIGHT;
  for (let i = NEIGHBOURS - 1; i >= 0; i--) {
    const weight = i > 0 ? Math.floor((nearness[i] * WEIGHT) / total) : rest;
    rest -= weight;
    weights[at + i] = weight;
    neighbours[at + i] = weight > 0 ? found[i] : 0;
  }
}

/** Decode integers [N, columns]. shifts: [N] steps of a point, as powers of two. ends: [N] number of columns of a point, by default all. */
export function decodeLod(
  data: Uint8Array,
  columns: number,
  levels: Levels,
  shifts: Uint8Array,
  ends?: Int32Array,
): Int32Array {
  const decoder = new EntropyDecoder(data, CONTEXTS);
  const { order, neighbours, weights } = levels;
  const found = new Int32Array(order.length * columns);
  const sizes = new Uint16Array(order.length * columns);
  for (let place = 0, w = 0; place < order.length; place++, w += NEIGHBOURS) {
    const point = order[place];
    const end = ends === undefined ? columns : ends[point];
    if (end === 0) continue;
    for (let k = 0; k < NEIGHBOURS; k++) {
      near[k] = columns * neighbours[w + k];
      share[k] = weights[w + k];
    }
    decodePoint(decoder, found, sizes, columns * point, end, shifts[point]);
  }
  decoder.finish();
  return found;
}

/** Offsets in `found` of the neighbors of the present point, and their weights. */
const near = new Int32Array(NEIGHBOURS);
const share = new Int32Array(NEIGHBOURS);

/** Decode the first `end` columns of the point at offset `at` in `found`. */
function decodePoint(
  decoder: EntropyDecoder,
  found: Int32Array,
  sizes: Uint16Array,
  at: number,
  end: number,
  shift: number,
): void {
  const [a, b, c, d] = [near[0], near[1], near[2], near[3]];
  const [p, q, r, s] = [share[0], share[1], share[2], share[3]];
  let recent = -1;
  for (let column = 0; column < end; column++) {
    const sum = p * found[a + column] + q * found[b + column] + r * found[c + column] + s * found[d + column];
    const size =
      Math.imul(p, sizes[a + column]) +
      Math.imul(q, sizes[b + column]) +
      Math.imul(r, sizes[c + column]) +
      Math.imul(s, sizes[d + column]);
    const around = Math.min(size >> (9 + shift), LARGEST);
    if (recent < 0) recent = around;
    const number = decoder.next(CONTEXT_OF[(around + recent) >> 1]);
    const steps = (number + 1) >>> 1;
    const result = Math.floor((sum + WEIGHT / 2) / WEIGHT) + ((number & 1) === 1 ? -steps : steps) * (1 << shift);
    if (!(Math.abs(result) < LIMIT)) throw new ReelError("a section decodes to numbers that are too large");
    recent += (Math.min(8 * steps, LARGEST) - recent) >> 2;
    found[at + column] = result;
    sizes[at + column] = Math.min(steps * (1 << shift), LARGEST_SIZE);
  }
}
