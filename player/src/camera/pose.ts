/** Where a camera is and what it looks at. */
import type { Vec3 } from "../base/matrix";
import type { Quat } from "../base/quaternion";

/** Eye, turn of the axes (camera to world) and distance of the pivot in front. */
export interface CameraState {
  eye: Vec3;
  turn: Quat;
  distance: number;
}

/** A camera as the manifest writes it: K [9] and viewmat [16], row by row, OpenCV. */
export interface Pose {
  K: number[];
  viewmat: number[];
}

/** Where to begin; null: where the reel does. */
export interface Start {
  seconds: number | null;
  view: CameraState | null;
}
