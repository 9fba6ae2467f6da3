/** Limits of the view: those of the manifest, else derived from the reel's bounds and cameras. */
import {
  add,
  cross,
  dot,
  eyeOf,
  length,
  type Manifest,
  normalize,
  rotate,
  scale,
  subtract,
  type Vec3,
} from "@splatreel/decoder/internal";

/** The pivot may leave the bounds by this part of their diagonal. */
const MARGIN = 0.25;
/** Default maximum distance, relative to the farthest camera or corner. */
const REACH = 1.5;
/** Degrees beyond the limit at which the fade is complete, and the part of the image that remains. */
const GONE = 45;
const LEFT = 0.08;
/** Part of the nearest camera's distance within which the fade decreases, since the angle to the cameras is unstable there. */
const INSIDE = 0.3;

/** Distances, angle and floor within which the view is good. */
export class Limits {
  /** Diagonal of the bounds. */
  readonly extent: number;
  readonly center: Vec3;

  private readonly up: Vec3;
  private readonly bounds: [Vec3, Vec3];
  readonly focus: Vec3;
  private readonly distance: [number, number];
  /** Maximum angle to the nearest camera, in radians. */
  private readonly angle: number;
  private readonly floor: number;
  /** Unit vectors from the focus to the cameras. */
  private readonly sides: Vec3[];
  private readonly nearest: number;

  constructor({ bounds, up, camera, cameras, presentation }: Manifest) {
    const [low, high] = bounds;
    const { limits } = presentation;
    this.bounds = bounds;
    this.up = normalize(up);
    this.extent = Math.max(length(subtract(high, low)), 1e-6);
    this.center = scale(add(low, high), 0.5);
    this.focus = limits?.focus ?? this.center;
    const eyes = (cameras.length > 0 ? cameras : [camera]).map(({ viewmat }) => subtract(eyeOf(viewmat), this.focus));
    const far =
      REACH *
      Math.max(
        ...[low, high, eyeOf(camera.viewmat)].map((point) => length(subtract(point, this.focus))),
        ...eyes.map(length),
      );
    this.distance = limits?.distance ?? [0, far];
    this.angle = ((limits?.angle ?? 180) * Math.PI) / 180;
    this.floor = limits?.floor ?? -Infinity;
    this.sides = eyes.map(normalize);
    this.nearest = Math.min(...eyes.map(length));
  }

  /** Return the nearest permitted pivot. */
  middle(point: Vec3): Vec3 {
    const [low, high] = this.bounds;
    const margin = MARGIN * this.extent;
    return point.map((value, a) => Math.min(Math.max(value, low[a] - margin), high[a] + margin)) as Vec3;
  }

  /** Move a part of the way, 0 to 1, to the nearest permitted eye position. */
  eye(point: Vec3, part = 1): Vec3 {
    const out = subtract(point, this.focus);
    const way = length(out);
    const [near, far] = this.distance;
    const { side, angle } = this.nearestSide(out);
    const excess = angle - this.angle;
    const inward = excess > 0 && way > 0 ? rotate(out, normalize(cross(out, side)), part * excess) : out;
    const factor = 1 + part * (Math.min(Math.max(way, near), far) / (way || 1) - 1);
    return this.above(way > 0 ? add(this.focus, scale(inward, factor)) : point, part);
  }

  /** Move a part of the way to the nearest position above the floor. */
  above(point: Vec3, part = 1): Vec3 {
    return add(point, scale(this.up, part * Math.max(this.floor - dot(point, this.up), 0)));
  }

  /** Return the fade of a view from a position, 0 to 1, which increases beyond the limit of the angle. */
  fade(point: Vec3): number {
    const out = subtract(point, this.focus);
    const excess = this.nearestSide(out).angle - this.angle;
    if (excess <= 0) return 0;
    const inside = Math.min(length(out) / (INSIDE * this.nearest || 1), 1);
    const part = Math.min(excess / ((GONE * Math.PI) / 180), 1);
    return (1 - LEFT) * inside * inside * part * part * (3 - 2 * part);
  }

  private nearestSide(out: Vec3): { side: Vec3; angle: number } {
    const direction = normalize(out);
    const side = this.sides.reduce((best, next) => (dot(next, direction) > dot(best, direction) ? next : best));
    return { side, angle: Math.atan2(length(cross(direction, side)), dot(direction, side)) };
  }
}
