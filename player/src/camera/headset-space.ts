/** How a reel lies in the room of a headset, which has meters, y up, its floor at 0, and people who look along -z. */
import { add, cross, dot, eyeOf, length, normalize, scale, subtract, type Vec3 } from "../base/matrix";
import type { View } from "../base/view";
import type { Manifest } from "../reel/manifest";

/** Meters from the middle of the scene at which the capture's cameras stand, in the median: as people stand around something. */
const DISTANCE = 2;
/** Meters of the eyes above the floor. */
const EYES = 1.6;

export class HeadsetSpace {
  /** Meters a world unit. */
  readonly meters: number;

  /** The room's axes in the world, and where its origin lies. */
  private readonly axes: [Vec3, Vec3, Vec3];
  private readonly origin: Vec3;

  /** viewmat [16]: people begin there, upright. floor: the room's origin lies on its floor, else where the eyes are. */
  constructor({ bounds, up, camera, cameras }: Manifest, viewmat: number[], floor: boolean) {
    const middle = scale(add(...bounds), 0.5);
    const distances = (cameras.length > 0 ? cameras : [camera]).map(({ viewmat: m }) => length(subtract(eyeOf(m), middle))).sort((a, b) => a - b);
    this.meters = DISTANCE / Math.max(distances[distances.length >> 1], 1e-6);
    const y = normalize(up);
    const level = (v: Vec3): Vec3 => subtract(v, scale(y, dot(v, y)));
    const [ahead, above]: Vec3[] = [[viewmat[8], viewmat[9], viewmat[10]], [-viewmat[4], -viewmat[5], -viewmat[6]]];
    // Who looks straight down goes on looking at what is at the top of the picture.
    const forward = normalize(length(level(ahead)) > 0.05 ? level(ahead) : level(scale(above, -Math.sign(dot(ahead, y)))));
    const z = scale(forward, -1);
    this.axes = [cross(y, z), y, z];
    this.origin = subtract(eyeOf(viewmat), scale(y, floor ? EYES / this.meters : 0));
  }

  /** What a view of the headset sees, in world units. inverse [16]: room to eye; projection [16]; both column by column, as of WebXR. */
  view(inverse: ArrayLike<number>, projection: ArrayLike<number>, width: number, height: number, near: number): View {
    const { axes, origin, meters } = this;
    const rows = [0, 1, 2].map((i) => {
      const sign = i === 0 ? 1 : -1; // y and z point the other way
      const row = axes.reduce((sum, axis, a) => add(sum, scale(axis, sign * inverse[4 * a + i])), [0, 0, 0] as Vec3);
      return [...row, (sign * inverse[12 + i]) / meters - dot(row, origin)];
    });
    const P = projection;
    return {
      viewmat: [...rows.flat(), 0, 0, 0, 1],
      fx: (P[0] * width) / 2,
      fy: (P[5] * height) / 2,
      cx: ((1 - P[8]) * width) / 2,
      cy: ((1 + P[9]) * height) / 2,
      width,
      height,
      near,
    };
  }
}
