/** Positions and directions of cameras. */
import { type Vec3, viewmatOf } from "@splatreel/decoder/internal";
import { axesOf, quatOf, type Quat } from "../base/quaternion";

/** Eye, rotation (camera to world) and distance of the pivot in front. */
export interface CameraState {
  eye: Vec3;
  turn: Quat;
  distance: number;
}

/** A camera as in the manifest: K [9] and viewmat [16], row-major, OpenCV. */
export interface Pose {
  K: number[];
  viewmat: number[];
}

/** Time and view to begin with; null for the reel's own. */
export interface Start {
  seconds: number | null;
  view: CameraState | null;
}

/** Return the rotation (camera to world) of a viewmat [16]. */
export function turnOf(m: number[]): Quat {
  return quatOf([
    [m[0], m[1], m[2]],
    [m[4], m[5], m[6]],
    [m[8], m[9], m[10]],
  ]);
}

/** Return the viewmat [16] of a state. */
export function viewmatOfState({ eye, turn }: CameraState): number[] {
  return viewmatOf(eye, ...axesOf(turn));
}
