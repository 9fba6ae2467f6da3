/** Whole numbers of points, predicted from points nearby (docs/format.md). Exact: Python finds the same numbers. */
import { EntropyDecoder, unzigzag } from "./entropy";
import { ReelError } from "./errors";

const FIRST_LEVEL = 64;
const NEIGHBOURS = 4;
const REACH = 8;
const WEIGHT = 4096;
const LIMIT = 2 ** 30;
/** Sizes matter up to this many eighths of a step. */
const LARGEST = 4095;
const EDGES = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 512];
const CONTEXTS = EDGES.length + 1;
const CONTEXT_OF = Uint8Array.from({ length: LARGEST + 1 }, (_, size) => EDGES.filter((edge) => edge <= size).length);

/** In which order points are decoded, and from which others each is predicted. */
export interface Levels {
  /** [N] all points, level after level. */
  order: Uint32Array;
  /** Where each level starts in `order`, and the end. */
  starts: number[];
  /** [N, 4] by place in `order`: neighbours and their weights, which sum to 4096 or, in the first level, to 0. */
  neighbours: Uint32Array;
  weights: Uint16Array;
}

/** Levels of points at lattice positions [N, 3] in Morton order. */
export function levelsOf(lattice: ArrayLike<number>): Levels {
  const count = lattice.length / 3;
  const order = new Uint32Array(count);
  const neighbours = new Uint32Array(NEIGHBOURS * count);
  const weights = new Uint16Array(NEIGHBOURS * count);
  let stride = 1;
  while (Math.floor(count / (2 * stride)) >= FIRST_LEVEL) stride *= 2;
  let at = 0;
  for (let i = 0; i < count; i += stride) order[at++] = i;
  const starts = [0, at];
  for (; stride > 1; stride /= 2) {
    for (let i = stride / 2; i < count; i += stride, at++) {
      order[at] = i;
      nearest(lattice, count, i, stride, neighbours, weights, NEIGHBOURS * at);
    }
    starts.push(at);
  }
  return { order, starts, neighbours, weights };
}

const found = new Float64Array(NEIGHBOURS);
const squares = new Float64Array(NEIGHBOURS);
const nearness = new Float64Array(NEIGHBOURS);

/** The nearest of 16 multiples of stride around a point, ties to the earlier, and weights that fall with the distance. */
function nearest(lattice: ArrayLike<number>, count: number, point: number, stride: number, neighbours: Uint32Array, weights: Uint16Array, at: number): void {
  const middle = Math.floor(point / stride);
  squares.fill(Infinity);
  for (let slot = middle + 1 - REACH; slot <= middle + REACH; slot++) {
    const candidate = slot * stride;
    if (candidate < 0 || candidate >= count) continue;
    let square = 0;
    for (let a = 0; a < 3; a++) square += (lattice[3 * candidate + a] - lattice[3 * point + a]) ** 2;
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

/** Whole numbers [columns][N]. shifts: [N], the steps of a point are 2^shift. */
export async function decodeField(data: Uint8Array, columns: number, levels: Levels, shifts: Uint8Array): Promise<Int32Array[]> {
  const decoder = await EntropyDecoder.open(data, CONTEXTS);
  const { order, starts, neighbours, weights } = levels;
  const count = order.length;
  const values = Array.from({ length: columns }, () => new Int32Array(count));
  const sizes = new Int32Array(count * columns);
  const recent = new Int32Array(count);
  for (let level = 0; level + 1 < starts.length; level++) {
    for (let column = 0; column < columns; column++) {
      const value = values[column];
      const size = sizes.subarray(column * count, (column + 1) * count);
      decoder.begin();
      for (let place = starts[level]; place < starts[level + 1]; place++) {
        const point = order[place];
        let sum = 0;
        let sizeSum = 0;
        for (let i = NEIGHBOURS * place; i < NEIGHBOURS * (place + 1); i++) {
          sum += value[neighbours[i]] * weights[i];
          sizeSum += size[neighbours[i]] * weights[i];
        }
        const shift = shifts[point];
        const around = sizeSum === 0 ? 0 : Math.min(Math.floor(sizeSum / (512 << shift)), LARGEST);
        const before = column === 0 ? around : recent[point];
        const residual = unzigzag(decoder.next(CONTEXT_OF[(around + before) >> 1]));
        const steps = Math.abs(residual);
        recent[point] = before + ((Math.min(8 * steps, LARGEST) - before) >> 2);
        const result = Math.floor((sum + WEIGHT / 2) / WEIGHT) + residual * (1 << shift);
        if (Math.abs(result) >= LIMIT || steps >= LIMIT) throw new ReelError("a section decodes to numbers that are too large");
        value[point] = result;
        size[point] = steps << shift;
      }
    }
  }
  decoder.finish();
  return values;
}
