/** Positions and rays of what people hold, in the space of a headset. */
import { add, scale, type Vec3 } from "@splatreel/decoder/internal";
import type { XrFrame, XrInput } from "./headset-support";

/** A ray. */
export interface Ray {
  origin: Vec3;
  /** Unit vector. */
  direction: Vec3;
}

/** Return the position of a matrix [16], column-major. */
export function positionOf(matrix: ArrayLike<number>): Vec3 {
  return [matrix[12], matrix[13], matrix[14]];
}

/** Return the ray along which an input points; null while it is not tracked. */
export function rayOf(frame: XrFrame, input: XrInput, space: object): Ray | null {
  const pose = frame.getPose(input.targetRaySpace, space);
  if (!pose) return null;
  const { matrix } = pose.transform;
  return { origin: positionOf(matrix), direction: [-matrix[8], -matrix[9], -matrix[10]] };
}

/** Return where a ray meets a level plane within a distance in meters; null if it does not. */
export function meetsLevel({ origin, direction }: Ray, height: number, most: number): Vec3 | null {
  const way = (height - origin[1]) / direction[1];
  return way > 0 && way <= most ? add(origin, scale(direction, way)) : null;
}
