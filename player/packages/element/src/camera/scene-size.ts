/** Size of a scene in meters, estimated from its cameras, since captures rarely know it. */
import { add, eyeOf, length, type Manifest, scale, subtract } from "@splatreel/decoder/internal";

/** Assumed median distance in meters of the capture's cameras from the center of the scene. */
const DISTANCE = 2;

/** Return the meters per world unit. */
export function metersPerUnit({ bounds, camera, cameras }: Pick<Manifest, "bounds" | "camera" | "cameras">): number {
  const middle = scale(add(...bounds), 0.5);
  const distances = (cameras.length > 0 ? cameras : [camera])
    .map(({ viewmat }) => length(subtract(eyeOf(viewmat), middle)))
    .sort((a, b) => a - b);
  return DISTANCE / Math.max(distances[distances.length >> 1], 1e-6);
}
