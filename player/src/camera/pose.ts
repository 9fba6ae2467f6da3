/** Positions and directions of cameras. */
import type { Vec3 } from "@splatreel/decoder/base/matrix";
import type { Quat } from "../base/quaternion";

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
