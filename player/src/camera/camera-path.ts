/** A camera path: views and times of the reel at seconds of the path, and a smooth way through them (docs/format.md). */
import { ReelError } from "../base/errors";
import { add, dot, eyeOf, length, scale, subtract, viewmatOf, type Vec3 } from "../base/matrix";
import { axesOf, multiply, quatOf, slerp, turnAbout, turnBetween, type Quat } from "../base/quaternion";

/** at: seconds of the path; time: seconds of the reel; viewmat [16]: world to camera, row by row, OpenCV. */
export interface Keyframe {
  at: number;
  time: number;
  viewmat: number[];
}

/** A path as its file holds it. */
export interface PathFile {
  format: "splatreel-path";
  version: 1;
  loop: boolean;
  keyframes: Keyframe[];
}

/** Most keyframes of a file. */
const MOST = 10_000;
/** Ends nearer than this, in radians and in parts of the path's length, are one view. */
const SAME = 1e-5;
/** Seconds from one camera of the capture to the next. */
const LEG = 2;

export class CameraPath {
  private readonly eyes: Vec3[];
  private readonly turns: Quat[];
  /** At each keyframe: world units a second, and radians a second about the camera's own axes. */
  private readonly speeds: Vec3[];
  private readonly spins: Vec3[];

  /** keyframes: at least one, their `at` growing. loop: it begins again at the end, without a kink where the last view is the first. */
  constructor(readonly keyframes: readonly Keyframe[], readonly loop: boolean) {
    this.eyes = keyframes.map(({ viewmat }) => eyeOf(viewmat));
    this.turns = keyframes.map(({ viewmat: m }) => quatOf([[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]]));
    const steps = keyframes.slice(1).map(({ at }, i) => at - keyframes[i].at);
    const ways = steps.map((_, i) => subtract(this.eyes[i + 1], this.eyes[i]));
    const arcs = steps.map((_, i) => turnBetween(this.turns[i], this.turns[i + 1]));
    const whole = ways.reduce((sum, way) => sum + length(way), 0);
    const last = steps.length;
    const gap = subtract(this.eyes[last], this.eyes[0]);
    const round = loop && last > 1 && length(gap) <= SAME * whole && length(turnBetween(this.turns[last], this.turns[0])) <= SAME;
    this.speeds = tangents(ways, steps, round);
    this.spins = tangents(arcs, steps, round);
  }

  /** There and back through cameras, viewmats [16], from a view and always on to the nearest that was not passed. No time of the reel. */
  static through(start: number[], cameras: number[][]): CameraPath {
    const stops = nearestFirst(start, cameras);
    const back = stops.slice(0, -1).reverse();
    return new CameraPath([...stops, ...back].map((viewmat, i) => ({ at: LEG * i, time: 0, viewmat })), true);
  }

  /** Seconds that it takes. */
  get seconds(): number {
    return this.keyframes.at(-1)!.at;
  }

  /** Where it is after some seconds, and seconds of the reel a second; `cut`: from one keyframe to the next without a move. */
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

  /** The keyframe that was passed last; the last but one at the end. */
  private leg(seconds: number): number {
    const { keyframes } = this;
    const next = keyframes.findIndex(({ at }, i) => i > 0 && at > seconds);
    return next < 0 ? Math.max(keyframes.length - 2, 0) : next - 1;
  }

  toJSON(): PathFile {
    return { format: "splatreel-path", version: 1, loop: this.loop, keyframes: [...this.keyframes] };
  }
}

/** Cameras, viewmats [16], from a start and always on to the nearest that was not passed; one that stands at the start is. */
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

/** Read the JSON of a path file. name: of the file, for errors. Throws `ReelError`. */
export function parsePath(value: unknown, name: string): CameraPath {
  const wrong = (why: string): never => {
    throw new ReelError(`${name} is not a camera path: ${why}`);
  };
  const json = (typeof value === "object" && value !== null ? value : {}) as Partial<Record<keyof PathFile, unknown>>;
  const shown = (item: unknown): string => (JSON.stringify(item) ?? "absent").slice(0, 80);
  if (json.format !== "splatreel-path") wrong(`its format is ${shown(json.format)}. Give one that this player saved.`);
  if (json.version !== 1) wrong(`its version is ${shown(json.version)}, and this player knows version 1. Update the player.`);
  const list = json.keyframes;
  if (!Array.isArray(list) || list.length < 1 || list.length > MOST) return wrong(`its keyframes are not a list of 1 to ${MOST}. Add one.`);
  let before = -1;
  const keyframes = list.map((item: Partial<Keyframe> | null, i): Keyframe => {
    const { at, time, viewmat } = item ?? {};
    const field = (what: string, found: unknown, remedy: string): never => wrong(`${what} of keyframe ${i} is ${shown(found)}. ${remedy}`);
    if (!isSeconds(at) || at <= before) return field("at", at, "Give seconds from 0 on that grow from keyframe to keyframe.");
    if (!isSeconds(time)) return field("time", time, "Give seconds of the reel, from 0 on.");
    if (!isPose(viewmat)) return field("viewmat", viewmat, "Give 16 numbers, row by row: a turn, a shift, and 0, 0, 0, 1.");
    before = at;
    return { at, time, viewmat };
  });
  return new CameraPath(keyframes, json.loop === true);
}

function isSeconds(value: unknown): value is number {
  return typeof value === "number" && value >= 0 && value <= 1e6;
}

function isPose(m: unknown): m is number[] {
  if (!Array.isArray(m) || m.length !== 16 || !m.every((part) => typeof part === "number" && Math.abs(part) < 1e12)) return false;
  const rows = [0, 4, 8].map((i) => m.slice(i, i + 3) as Vec3);
  const off = rows.flatMap((a, i) => rows.map((b, j) => Math.abs(dot(a, b) - (i === j ? 1 : 0))));
  const [[a, b, c], [d, e, f], [g, h, k]] = rows;
  const upright = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g) > 0;
  return Math.max(...off) < 1e-3 && upright && m[12] === 0 && m[13] === 0 && m[14] === 0 && m[15] === 1;
}

/**
 * Rates at the keyframes of a curve with these moves between them: of a parabola through three, but no more than three times
 * that of the slower side, so that between equal keyframes it rests. round: the last keyframe is the first.
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

/** A part of the way from a to b, leaving with u and coming with v. */
function hermite(a: Vec3, u: Vec3, b: Vec3, v: Vec3, t: number): Vec3 {
  const [s, c] = [t * t, t * t * t];
  return add(add(scale(a, 1 - 3 * s + 2 * c), scale(b, 3 * s - 2 * c)), add(scale(u, t - 2 * s + c), scale(v, c - s)));
}

/** The same on the sphere of turns, by de Casteljau's construction; u and v: radians about the camera's own axes. */
function arc(a: Quat, u: Vec3, b: Quat, v: Vec3, t: number): Quat {
  let points = [a, multiply(a, turnAbout(scale(u, 1 / 3))), multiply(b, turnAbout(scale(v, -1 / 3))), b];
  while (points.length > 1) points = points.slice(1).map((point, i) => slerp(points[i], point, t));
  return points[0];
}
