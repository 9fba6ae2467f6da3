/** Checks of views given by links, which may hold anything. */
import { dot, eyeOf, length, type Manifest, normalize, subtract, type Vec3 } from "@splatreel/decoder/internal";
import { Limits } from "./limits";
import type { CameraState } from "./pose";

/** Return a view if people could reach it; null if it is far outside, below the floor, or has a distant pivot. */
export function reachable(view: CameraState, manifest: Manifest): CameraState | null {
  const { eye, distance } = view;
  const limits = new Limits(manifest);
  // A drag may exceed the limits by this much until it is released.
  const beyond = length(subtract(limits.eye(eye), eye));
  if (!(beyond <= 0.25 * limits.extent) || !(distance <= 10 * limits.extent + length(subtract(eye, limits.center))))
    return null;
  return dot(eye, normalize(manifest.up)) >= floorOf(manifest) - 0.01 * limits.extent ? view : null;
}

/** Return the floor height along `up`: the limit, else the lowest camera or corner of the bounds. */
function floorOf({ bounds, up, camera, cameras, presentation }: Manifest): number {
  const corners = Array.from(
    { length: 8 },
    (_, corner) => [0, 1, 2].map((axis) => bounds[(corner >> axis) & 1][axis]) as Vec3,
  );
  const eyes = [camera, ...cameras].map(({ viewmat }) => eyeOf(viewmat));
  return presentation.limits?.floor ?? Math.min(...[...corners, ...eyes].map((point) => dot(point, normalize(up))));
}
