/** Maps a reel into the space of a headset: meters, y up, floor at 0, forward along -z. */
import {
  add,
  cross,
  dot,
  eyeOf,
  length,
  type Manifest,
  normalize,
  scale,
  subtract,
  type Vec3,
} from "@splatreel/decoder/internal";
import { intrinsicsOf, type View } from "@splatreel/renderer";
import { metersPerUnit } from "./scene-size";

/** Height of the eyes above the floor, in meters. */
const EYES = 1.6;
/** Maximum factor by which people scale a reel up or down. */
const MOST = 50;

/** Scale and pose of a reel in the space of a headset. */
export class HeadsetSpace {
  /** Height of the floor. */
  readonly floor: number;
  /** Meters per world unit. */
  private scale: number;
  /** Meters per world unit that `transform` may reach. */
  private readonly scales: [number, number];
  /** Axes and origin of the headset's space in world units. */
  private axes: [Vec3, Vec3, Vec3];
  private origin: Vec3;

  /** viewmat [16]: the first view, made upright. floor: whether the origin is on the floor, or at the eyes. */
  constructor(manifest: Manifest, viewmat: number[], floor: boolean) {
    this.scale = metersPerUnit(manifest);
    this.scales = [this.scale / MOST, this.scale * MOST];
    this.floor = floor ? 0 : -EYES;
    const y = normalize(manifest.up);
    const level = (v: Vec3): Vec3 => subtract(v, scale(y, dot(v, y)));
    const [ahead, above]: Vec3[] = [
      [viewmat[8], viewmat[9], viewmat[10]],
      [-viewmat[4], -viewmat[5], -viewmat[6]],
    ];
    // A view straight down faces the direction of the top of the image.
    const forward = normalize(
      length(level(ahead)) > 0.05 ? level(ahead) : level(scale(above, -Math.sign(dot(ahead, y)))),
    );
    const z = scale(forward, -1);
    this.axes = [cross(y, z), y, z];
    this.origin = subtract(eyeOf(viewmat), scale(y, floor ? EYES / this.scale : 0));
  }

  get meters(): number {
    return this.scale;
  }

  /** Scale the reel and turn it, in radians counterclockwise as seen from above, about a point of the space, which moves to another. */
  transform(factor: number, yaw: number, from: Vec3, to: Vec3): void {
    const [low, high] = this.scales;
    const next = Math.min(Math.max(factor * this.scale, low), high);
    const point = this.worldOf(from);
    const [x, y, z] = this.axes;
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    this.axes = [add(scale(x, c), scale(z, s)), y, subtract(scale(z, c), scale(x, s))];
    this.scale = next;
    this.origin = subtract(point, scale(this.along(to), 1 / next));
  }

  /** Return the world position of a point of the space. */
  worldOf(point: Vec3): Vec3 {
    return add(this.origin, scale(this.along(point), 1 / this.scale));
  }

  /** Return the point of the space at a world position. */
  pointOf(world: Vec3): Vec3 {
    const way = scale(subtract(world, this.origin), this.scale);
    return this.axes.map((axis) => dot(axis, way)) as Vec3;
  }

  /** Return the direction in the world of a vector of the space. */
  private along(vector: Vec3): Vec3 {
    return this.axes.reduce((sum, axis, i) => add(sum, scale(axis, vector[i])), [0, 0, 0] as Vec3);
  }

  /** Return a view of the headset in world units. inverse [16]: space to eye; projection [16]; both column-major, as in WebXR. */
  view(inverse: ArrayLike<number>, projection: ArrayLike<number>, width: number, height: number, near: number): View {
    const { axes, origin, meters } = this;
    const rows = [0, 1, 2].map((i) => {
      const sign = i === 0 ? 1 : -1; // y and z axes have opposite signs in OpenCV
      const row = axes.reduce((sum, axis, a) => add(sum, scale(axis, sign * inverse[4 * a + i])), [0, 0, 0] as Vec3);
      return [...row, (sign * inverse[12 + i]) / meters - dot(row, origin)];
    });
    return { viewmat: [...rows.flat(), 0, 0, 0, 1], ...intrinsicsOf(projection, width, height), near };
  }
}
