/** Maps a reel into the space of a headset: meters, y up, floor at 0, forward along -z. */
import { add, cross, dot, eyeOf, length, normalize, scale, subtract, type Vec3 } from "@splatreel/decoder/base/matrix";
import { intrinsicsOf, type View } from "../base/view";
import type { Manifest } from "@splatreel/decoder/reel/manifest";
import { metersPerUnit } from "./scene-size";

/** Height of the eyes above the floor, in meters. */
const EYES = 1.6;

/** Scale and pose of a reel in the space of a headset. */
export class HeadsetSpace {
  /** Meters per world unit. */
  readonly meters: number;

  /** Axes and origin of the headset's space in world units. */
  private readonly axes: [Vec3, Vec3, Vec3];
  private readonly origin: Vec3;

  /** viewmat [16]: the first view, made upright. floor: whether the origin is on the floor, or at the eyes. */
  constructor(manifest: Manifest, viewmat: number[], floor: boolean) {
    this.meters = metersPerUnit(manifest);
    const y = normalize(manifest.up);
    const level = (v: Vec3): Vec3 => subtract(v, scale(y, dot(v, y)));
    const [ahead, above]: Vec3[] = [[viewmat[8], viewmat[9], viewmat[10]], [-viewmat[4], -viewmat[5], -viewmat[6]]];
    // A view straight down faces the direction of the top of the image.
    const forward = normalize(length(level(ahead)) > 0.05 ? level(ahead) : level(scale(above, -Math.sign(dot(ahead, y)))));
    const z = scale(forward, -1);
    this.axes = [cross(y, z), y, z];
    this.origin = subtract(eyeOf(viewmat), scale(y, floor ? EYES / this.meters : 0));
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
