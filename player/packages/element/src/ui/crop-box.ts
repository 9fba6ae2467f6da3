/** The box and the marks of an edit, and the operations of `splatreel edit` that they stand for. */
import { add, dot, length, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { Sphere, View } from "@splatreel/renderer";

/** Low and high corner, world units. */
export type Box = [Vec3, Vec3];

/** A face of a box: an axis, 0 to 2, and a side, 0 for low and 1 for high. */
export interface Face {
  axis: number;
  side: 0 | 1;
}

export const FACES: Face[] = [0, 1, 2].flatMap((axis) => [
  { axis, side: 0 as const },
  { axis, side: 1 as const },
]);

/** A place to clean. range: frames from the first to before the second; null for all. */
export interface Mark extends Sphere {
  range: [number, number] | null;
}

/** Smallest extent of a box, relative to the box that it began as. */
const THIN = 1e-3;

/** Return a first box: around what the cameras look at, small enough to be in front of the viewer, and within the bounds. */
export function firstBox(bounds: Box, focus: Vec3, eye: Vec3): Box {
  const most = 0.3 * length(subtract(focus, eye));
  const side = (axis: number, sign: 1 | -1): number => {
    const border = bounds[sign === 1 ? 1 : 0][axis];
    const reach = focus[axis] + sign * most;
    return sign === 1
      ? Math.max(Math.min(border, reach), focus[axis] + 0.1 * most)
      : Math.min(Math.max(border, reach), focus[axis] - 0.1 * most);
  };
  return [
    [side(0, -1), side(1, -1), side(2, -1)],
    [side(0, 1), side(1, 1), side(2, 1)],
  ];
}

/** Return the middle of a face. */
export function middleOf(box: Box, { axis, side }: Face): Vec3 {
  const middle = scale(add(box[0], box[1]), 0.5);
  middle[axis] = box[side][axis];
  return middle;
}

/** Return the edges of a box, as pairs of corners. */
export function edgesOf(box: Box): [Vec3, Vec3][] {
  const corner = (bits: number): Vec3 => [0, 1, 2].map((axis) => box[(bits >> axis) & 1][axis]) as Vec3;
  return [0, 1, 2, 3, 4, 5, 6, 7].flatMap((bits) =>
    [1, 2, 4].filter((bit) => !(bits & bit)).map((bit): [Vec3, Vec3] => [corner(bits), corner(bits | bit)]),
  );
}

/** Return a box whose face was dragged by pixels, so that it follows the pointer along its axis. Opposite faces do not pass each other. */
export function dragged(box: Box, face: Face, [dx, dy]: [number, number], view: View): Box {
  const { axis, side } = face;
  const from = projected(middleOf(box, face), view);
  const extent = box[1][axis] - box[0][axis];
  const step = 0.01 * extent;
  const ahead = middleOf(box, face);
  ahead[axis] += step;
  const to = projected(ahead, view);
  if (!from || !to) return box;
  const along = [(to[0] - from[0]) / step, (to[1] - from[1]) / step]; // pixels per world unit
  const square = along[0] ** 2 + along[1] ** 2;
  if (square < 1e-6) return box;
  const moved: Box = [[...box[0]], [...box[1]]];
  const value = box[side][axis] + (dx * along[0] + dy * along[1]) / square;
  const room = THIN * extent;
  moved[side][axis] = side === 0 ? Math.min(value, box[1][axis] - room) : Math.max(value, box[0][axis] + room);
  return moved;
}

/** Return the pixel of a point; null behind the viewer. */
export function projected(point: Vec3, { viewmat: m, fx, fy, cx, cy, near }: View): [number, number] | null {
  const [x, y, z] = [0, 4, 8].map((i) => dot(point, m.slice(i, i + 3) as Vec3) + m[i + 3]);
  return z < near ? null : [(fx * x) / z + cx, (fy * y) / z + cy];
}

/** Return the point at a pixel and a depth. */
export function pointAt([x, y]: [number, number], depth: number, { viewmat: m, fx, fy, cx, cy }: View): Vec3 {
  const seen: Vec3 = [((x - cx) / fx) * depth, ((y - cy) / fy) * depth, depth];
  const away = subtract(seen, [m[3], m[7], m[11]]);
  return [0, 1, 2].map((column) => dot(away, [m[column], m[4 + column], m[8 + column]])) as Vec3;
}

/** Return the marks that hide points at a frame. */
export function marksAt(marks: Mark[], frame: number): Mark[] {
  return marks.filter(({ range }) => range === null || (frame >= range[0] && frame < range[1]));
}

/** Return the operations of an edit. box: null keeps everything. */
export function operationsOf(box: Box | null, marks: Mark[], transparent: boolean): string[] {
  const removals = marks.map(
    ({ center, radius, range }) => `remove=sphere:${texts([...center, radius])}${range ? `@${range.join(":")}` : ""}`,
  );
  const crop = box ? [`crop=box:${texts([...box[0], ...box[1]])}`] : [];
  return [...removals, ...crop, ...(transparent ? ["background=transparent"] : [])];
}

/** Return numbers with four digits after the first. */
function texts(values: number[]): string {
  return values.map((value) => String(Number(value.toPrecision(5)))).join(",");
}
