/** Which views can be: those of links are anybody's. */
import { dot, eyeOf, length, normalize, subtract, type Vec3 } from "../base/matrix";
import type { Manifest } from "../reel/manifest";
import { Limits } from "./limits";
import type { CameraState } from "./pose";

/** A view that somebody could have come to; null where it is far outside, below the floor, or turns about nothing that there is. */
export function reachable(view: CameraState, manifest: Manifest): CameraState | null {
  const { eye, distance } = view;
  const limits = new Limits(manifest);
  // Beyond the limits by no more than a hand goes that holds the picture.
  const beyond = length(subtract(limits.eye(eye), eye));
  if (!(beyond <= 0.25 * limits.extent) || !(distance <= 10 * limits.extent + length(subtract(eye, limits.center)))) return null;
  return dot(eye, normalize(manifest.up)) >= floorOf(manifest) - 0.01 * limits.extent ? view : null;
}

/** The height along `up` below which nobody stands: the limit, else where neither the box nor a camera reaches. */
function floorOf({ bounds, up, camera, cameras, presentation }: Manifest): number {
  const corners = Array.from({ length: 8 }, (_, corner) => [0, 1, 2].map((axis) => bounds[(corner >> axis) & 1][axis]) as Vec3);
  const eyes = [camera, ...cameras].map(({ viewmat }) => eyeOf(viewmat));
  return presentation.limits?.floor ?? Math.min(...[...corners, ...eyes].map((point) => dot(point, normalize(up))));
}
