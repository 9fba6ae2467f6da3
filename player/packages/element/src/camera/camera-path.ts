/** Camera paths: keyframes of view and reel time, and smooth interpolation between them (docs/format.md). */
import { add, dot, eyeOf, length, ReelError, scale, subtract, type Vec3, viewmatOf } from "@splatreel/decoder/internal";
import { axesOf, multiply, quatOf, slerp, turnAbout, turnBetween, type Quat } from "../base/quaternion";

/** A view and time of the reel. at: seconds of the path; time: seconds of the reel; viewmat [16]: world to camera, row-major, OpenCV. */
export interface Keyframe {
  at: number;
  time: number;
  viewmat: number[];
}

/** JSON of a path file. */
export interface PathFile {
  format: "splatreel-path";
  version: 1;
  loop: boolean;
  keyframes: Keyframe[];
}

/** Maximum number of keyframes. */
const MAX_KEYFRAMES = 10_000;
/** A loop whose ends differ by less than this, in radians and relative to its length, is smooth at its ends. */
const SAME = 1e-5;
/** Seconds between cameras of the capture. */
const LEG = 2;

/** A smooth path through keyframes. */
export class CameraPath {
  private readonly eyes: Vec3[];
  private readonly turns: Quat[];
  /** Tangents at the keyframes: world units per second, and rotation vectors per second in the camera's frame. */
  private readonly speeds: Vec3[];
  private readonly spins: Vec3[];

  /** keyframes: at least one, with increasing `at`. loop: repeat, smoothly if the first and last views agree. */
  constructor(
    readonly keyframes: readonly Keyframe[],
    readonly loop: boolean,
  ) {
    this.eyes = keyframes.map(({ viewmat }) => eyeOf(viewmat));
    this.turns = keyframes.map(({ viewmat: m }) =>
      quatOf([
        [m[0], m[1], m[2]],
        [m[4], m[5], m[6]],
        [m[8], m[9], m[10]],
      ]),
    );
    const steps = keyframes.slice(1).map(({ at }, i) => at - keyframes[i].at);
    const ways = steps.map((_, i) => subtract(this.eyes[i + 1], this.eyes[i]));
    const arcs = steps.map((_, i) => turnBetween(this.turns[i], this.turns[i + 1]));
    const whole = ways.reduce((sum, way) => sum + length(way), 0);
    const last = steps.length;
    const gap = subtract(this.eyes[last], this.eyes[0]);
    const round =
      loop && last > 1 && length(gap) <= SAME * whole && length(turnBetween(this.turns[last], this.turns[0])) <= SAME;
    this.speeds = tangents(ways, steps, round);
    this.spins = tangents(arcs, steps, round);
  }

  /** Return a looping path from a view through cameras, viewmats [16], nearest first, and back. It has no reel time. */
  static through(start: number[], cameras: number[][]): CameraPath {
    const stops = nearestFirst(start, cameras);
    const back = stops.slice(0, -1).reverse();
    return new CameraPath(
      [...stops, ...back].map((viewmat, i) => ({ at: LEG * i, time: 0, viewmat })),
      true,
    );
  }

  /** Duration in seconds. */
  get seconds(): number {
    return this.keyframes.at(-1)!.at;
  }

  /** Return the view, the time of the reel, and the rate of that time. cut: jump between keyframes instead of moving. */
  at(seconds: number, cut = false): { viewmat: number[]; time: number; pace: number } {
    const { keyframes, eyes, turns } = this;
    const now = this.loop && this.seconds > 0 ? seconds % this.seconds : seconds;
    const i = this.leg(now);
    const [from, to] = [keyframes[i], keyframes[i + 1]];
    const t = to ? Math.min(Math.max((now - from.at) / (to.at - from.at), 0), 1) : 0;
    if (!to) return { viewmat: from.viewmat, time: from.time, pace: 0 };
    const step = to.at - from.at;
    const pace = (to.time - from.time) / step;
    const time = from.time + pace * step * t;
    if (cut) return { viewmat: from.viewmat, time, pace };
    const eye = hermite(eyes[i], scale(this.speeds[i], step), eyes[i + 1], scale(this.speeds[i + 1], step), t);
    const turn = arc(turns[i], scale(this.spins[i], step), turns[i + 1], scale(this.spins[i + 1], step), t);
    return { viewmat: viewmatOf(eye, ...axesOf(turn)), time, pace };
  }

  /** Return the index of the last passed keyframe, at most the last but one. */
  private leg(seconds: number): number {
    const { keyframes } = this;
    const next = keyframes.findIndex(({ at }, i) => i > 0 && at > seconds);
    return next < 0 ? Math.max(keyframes.length - 2, 0) : next - 1;
  }

  /** Return the JSON of a path file. */
  toJSON(): PathFile {
    return { format: "splatreel-path", version: 1, loop: this.loop, keyframes: [...this.keyframes] };
  }
}

/** Order cameras, viewmats [16], from a start on, each followed by the nearest one left. A camera at the start is left out. */
export function nearestFirst(start: number[], cameras: number[][]): number[][] {
  const way = (a: number[], b: number[]): number => length(subtract(eyeOf(a), eyeOf(b)));
  const left = cameras.filter((camera) => way(camera, start) > 1e-6);
  const stops = [start];
  while (left.length > 0) {
    const distances = left.map((camera) => way(camera, stops.at(-1)!));
    stops.push(...left.splice(distances.indexOf(Math.min(...distances)), 1));
  }
  return stops;
}

/** Parse the JSON of a path file. name: of the file, for errors. Throws `ReelError`. */
export function parsePath(value: unknown, name: string): CameraPath {
  const wrong = (why: string): never => {
    throw new ReelError(`${name} is not a camera path: ${why}`);
  };
  const json = (typeof value === "object" && value !== null ? value : {}) as Partial<Record<keyof PathFile, unknown>>;
  const shown = (item: unknown): string => (JSON.stringify(item) ?? "absent").slice(0, 80);
  if (json.format !== "splatreel-path") wrong(`its format is ${shown(json.format)}. Give one that this player saved.`);
  if (json.version !== 1)
    wrong(`its version is ${shown(json.version)}, and this player knows version 1. Update the player.`);
  const list = json.keyframes;
  if (!Array.isArray(list) || list.length < 1 || list.length > MAX_KEYFRAMES)
    return wrong(`its keyframes are not a list of 1 to ${MAX_KEYFRAMES}. Add one.`);
  let before = -1;
  const keyframes = list.map((item: Partial<Keyframe> | null, i): Keyframe => {
    const { at, time, viewmat } = item ?? {};
    const field = (what: string, found: unknown, remedy: string): never =>
      wrong(`${what} of keyframe ${i} is ${shown(found)}. ${remedy}`);
    if (!isSeconds(at) || at <= before)
      return field("at", at, "Give seconds from 0 on that grow from keyframe to keyframe.");
    if (!isSeconds(time)) return field("time", time, "Give seconds of the reel, from 0 on.");
    if (!isPose(viewmat))
      return field("viewmat", viewmat, "Give 16 numbers, row by row: a turn, a shift, and 0, 0, 0, 1.");
    before = at;
    return { at, time, viewmat };
  });
  return new CameraPath(keyframes, json.loop === true);
}

function isSeconds(value: unknown): value is number {
  return typeof value === "number" && value >= 0 && value <= 1e6;
}

function isPose(m: unknown): m is number[] {
  if (!Array.isArray(m) || m.length !== 16 || !m.every((part) => typeof part === "number" && Math.abs(part) < 1e12))
    return false;
  const rows = [0, 4, 8].map((i) => m.slice(i, i + 3) as Vec3);
  const off = rows.flatMap((a, i) => rows.map((b, j) => Math.abs(dot(a, b) - (i === j ? 1 : 0))));
  const [[a, b, c], [d, e, f], [g, h, k]] = rows;
  const upright = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g) > 0;
  return Math.max(...off) < 1e-3 && upright && m[12] === 0 && m[13] === 0 && m[14] === 0 && m[15] === 1;
}

/**
 * Return the rates at the keyframes of a curve: that of the parabola through three keyframes, limited to three times the slower side, so
 * that the curve does not move between equal keyframes. moves, steps: differences and seconds between keyframes. round: the last keyframe
 * equals the first.
 */
function tangents(moves: Vec3[], steps: number[], round: boolean): Vec3[] {
  const count = moves.length;
  if (count === 0) return [[0, 0, 0]];
  const rates = moves.map((move, i) => scale(move, 1 / steps[i]));
  return Array.from({ length: count + 1 }, (_, i) => {
    const inner = i > 0 && i < count;
    if (!inner && !round) return rates[i === 0 ? 0 : count - 1];
    const [a, b] = inner ? [i - 1, i] : [count - 1, 0];
    const mean = scale(add(scale(rates[a], steps[b]), scale(rates[b], steps[a])), 1 / (steps[a] + steps[b]));
    const most = 3 * Math.min(length(rates[a]), length(rates[b]));
    return scale(mean, Math.min(most / Math.max(length(mean), 1e-12), 1));
  });
}

/** Interpolate from a to b at t in 0..1, with tangents u and v. */
function hermite(a: Vec3, u: Vec3, b: Vec3, v: Vec3, t: number): Vec3 {
  const [s, c] = [t * t, t * t * t];
  return add(add(scale(a, 1 - 3 * s + 2 * c), scale(b, 3 * s - 2 * c)), add(scale(u, t - 2 * s + c), scale(v, c - s)));
}

/** Interpolate rotations likewise, by de Casteljau's algorithm. u and v: rotation vectors in the camera's frame. */
function arc(a: Quat, u: Vec3, b: Quat, v: Vec3, t: number): Quat {
  let points = [a, multiply(a, turnAbout(scale(u, 1 / 3))), multiply(b, turnAbout(scale(v, -1 / 3))), b];
  while (points.length > 1) points = points.slice(1).map((point, i) => slerp(points[i], point, t));
  return points[0];
}
