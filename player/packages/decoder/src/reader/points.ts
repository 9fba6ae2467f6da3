/** The Gaussians that a reel shows at a time, as plain arrays (docs/format.md, "Showing time t"). */
import type { Vec3 } from "../base/matrix";
import type { DecodedGroup, DecodedLayer } from "../decode/decode-file";
import type { Gaussians } from "../decode/gaussians";
import { lightAt } from "../decode/light";
import type { Offsets } from "../decode/offsets";

/** Value of the first spherical harmonic. */
const C0 = 0.28209479177387814;
/** Largest opacity that a fade starts from, so that its optical depth is finite. */
const OPAQUE = 0.9999;

/** Gaussians as plain arrays, row by row. */
export interface Points {
  count: number;
  /** Degree of the spherical harmonics, 0 to 3. */
  shDegree: number;
  /** [N, 3] centers in world units. */
  means: Float32Array;
  /** [N, 4] unit quaternions wxyz. */
  quats: Float32Array;
  /** [N, 3] standard deviations in world units. */
  scales: Float32Array;
  /** [N] 0 to 1. */
  opacities: Float32Array;
  /** [N, (degree + 1)^2, 3] coefficients in the 3DGS order. The color is 0.5 plus their sum. */
  sh: Float32Array;
}

/** A group with the layers that live at it, as decoded. */
export interface GroupData {
  group: DecodedGroup;
  /** In the order in which `alive` lists their points. */
  layers: { uri: string; file: DecodedLayer }[];
}

/** A group at a frame, counted from its first. */
export interface GroupAt extends GroupData {
  frame: number;
}

/** Points of one file to show. rows: indices; null for all. weight: of a fade, 0 to 1; null for none. */
interface Part {
  points: Gaussians;
  rows: Uint32Array | null;
  weight: number | null;
  offsets?: Offsets | null;
  frame?: number;
}

/** Return the Gaussians of a moment. previous: group that fades out. weight: of the current group, 0 to 1. */
export function pointsAt(current: GroupAt, previous: GroupAt | null, weight: number): Points {
  const parts = previous
    ? fadingParts(current, previous, weight)
    : [...staticParts(current, (flag) => flag, null), dynamicPart(current, null)];
  const shown = parts.filter(({ points, rows }) => (rows?.length ?? points.count) > 0);
  return join(shown, lightAt(current.group.light, current.frame));
}

/** Points of both groups, then those that leave, then those that come. */
function fadingParts(current: GroupAt, previous: GroupAt, weight: number): Part[] {
  const [now, before] = [aliveIn(current), aliveIn(previous)];
  const isIn = (flags: Map<string, Uint8Array>, uri: string, row: number): number => flags.get(uri)?.[row] ?? 0;
  return [
    ...staticParts(current, (flag, uri, row) => flag & isIn(before, uri, row), null),
    ...staticParts(previous, (flag, uri, row) => flag & ~isIn(now, uri, row), 1 - weight),
    dynamicPart(previous, 1 - weight),
    ...staticParts(current, (flag, uri, row) => flag & ~isIn(before, uri, row), weight),
    dynamicPart(current, weight),
  ];
}

/** Return the `alive` flags of a group by layer. */
function aliveIn({ group, layers }: GroupData): Map<string, Uint8Array> {
  let first = 0;
  return new Map(layers.map(({ uri, file }) => [uri, group.alive.subarray(first, (first += file.points.count))]));
}

function staticParts(
  shown: GroupAt,
  select: (flag: number, uri: string, row: number) => number,
  weight: Part["weight"],
): Part[] {
  const alive = aliveIn(shown);
  return shown.layers.map(({ uri, file: { points } }) => {
    const flags = alive.get(uri)!;
    const rows = Uint32Array.from({ length: points.count }, (_, row) => row).filter(
      (row) => select(flags[row] ?? 0, uri, row) & 1,
    );
    return { points, rows, weight };
  });
}

function dynamicPart({ group: { points, offsets }, frame }: GroupAt, weight: Part["weight"]): Part {
  return { points, rows: null, weight, offsets, frame };
}

function join(parts: Part[], light: Vec3): Points {
  const count = parts.reduce((sum, { points, rows }) => sum + (rows?.length ?? points.count), 0);
  const shDegree = Math.max(0, ...parts.map(({ points }) => points.shDegree));
  const bands = (shDegree + 1) ** 2;
  const result: Points = {
    count,
    shDegree,
    means: new Float32Array(3 * count),
    quats: new Float32Array(4 * count),
    scales: new Float32Array(3 * count),
    opacities: new Float32Array(count),
    sh: new Float32Array(3 * bands * count),
  };
  let at = 0;
  for (const part of parts) at = write(part, result, at, bands);
  for (let i = 0; i < result.sh.length; i++) {
    const channel = i % 3;
    result.sh[i] = result.sh[i] * light[channel] + (i % (3 * bands) < 3 ? ((light[channel] - 1) * 0.5) / C0 : 0);
  }
  return result;
}

/** Write a part from row `at` of the result on. Returns the row after it. */
function write({ points, rows, weight, offsets, frame = 0 }: Part, result: Points, at: number, bands: number): number {
  const { means, quats, scales, opacities, shBase, shRest, codebook, shDegree } = points;
  const rest = 3 * ((shDegree + 1) ** 2 - 1);
  const total = rows?.length ?? points.count;
  for (let k = 0, to = at; k < total; k++, to++) {
    const i = rows ? rows[k] : k;
    for (let a = 0; a < 3; a++) {
      result.means[3 * to + a] = means[3 * i + a];
      result.scales[3 * to + a] = scales[3 * i + a];
      result.sh[3 * bands * to + a] = shBase[3 * i + a];
    }
    for (let a = 0; a < 4; a++) result.quats[4 * to + a] = quats[4 * i + a];
    result.opacities[to] = opacities[i];
    result.sh.set(codebook.subarray(rest * shRest[i], rest * (shRest[i] + 1)), 3 * (bands * to + 1));
  }
  if (offsets) move(offsets, frame, result, at, total, bands);
  if (weight !== null)
    for (let to = at; to < at + total; to++)
      result.opacities[to] = 1 - (1 - Math.min(result.opacities[to], OPAQUE)) ** weight;
  return at + total;
}

/** Apply motion, colors and opacities at a frame to `total` rows from `at` on. */
function move(offsets: Offsets, frame: number, result: Points, at: number, total: number, bands: number): void {
  const { dx, dxMin, dxStep, dq, appearance } = offsets;
  const low = Math.min(Math.floor(frame), offsets.frames - 1);
  const between = frame - low;
  const [first, second] = [4 * total * low, 4 * total * Math.min(low + 1, offsets.frames - 1)];
  const mix = (values: ArrayLike<number>, i: number): number =>
    values[first + i] + (values[second + i] - values[first + i]) * between;
  const [turn, next] = [new Float64Array(4), new Float64Array(4)];
  for (let k = 0, to = at; k < total; k++, to++) {
    for (let a = 0; a < 3; a++) result.means[3 * to + a] += dxMin[a] + dxStep[a] * mix(dx, 4 * k + a);
    rotationAt(offsets, dq, first + 4 * k, turn);
    rotationAt(offsets, dq, second + 4 * k, next);
    blend(turn, next, between);
    rotate(result.quats.subarray(4 * to, 4 * to + 4), turn, offsets.worldly);
    if (!appearance) continue;
    const gain = (a: number): number => appearance.min[a] + appearance.step[a] * mix(appearance.data, 4 * k + a);
    for (let a = 0; a < 3; a++) result.sh[3 * bands * to + a] += gain(a);
    result.opacities[to] = Math.min(Math.max(result.opacities[to] + gain(3), 0), 1);
  }
}

function rotationAt({ dqMin, dqStep }: Offsets, dq: Uint8Array, at: number, result: Float64Array): void {
  for (let a = 0; a < 4; a++) result[a] = dqMin[a] + dqStep[a] * dq[at + a];
  normalize(result);
}

/** Move a unit quaternion towards another along the shorter rotation. */
function blend(from: Float64Array, to: Float64Array, share: number): void {
  const sign = from[0] * to[0] + from[1] * to[1] + from[2] * to[2] + from[3] * to[3] < 0 ? -1 : 1;
  for (let a = 0; a < 4; a++) from[a] += (sign * to[a] - from[a]) * share;
  normalize(from);
}

function normalize(q: Float64Array): void {
  const size = Math.hypot(q[0], q[1], q[2], q[3]) || 1;
  for (let a = 0; a < 4; a++) q[a] /= size;
}

/** Multiply a rotation by another: from the left if it is about the axes of the world, from the right if about those of the point. */
function rotate(own: Float32Array, turn: Float64Array, worldly: boolean): void {
  const [[w, x, y, z], [s, a, b, c]] = worldly ? [turn, own] : [own, turn];
  own.set([
    w * s - x * a - y * b - z * c,
    w * a + x * s + y * c - z * b,
    w * b - x * c + y * s + z * a,
    w * c + x * b - y * a + z * s,
  ]);
}
