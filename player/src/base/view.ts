/** A pinhole view: viewmat [16], world to camera, row-major (OpenCV), and intrinsics in pixels of a width x height image. */
export interface View {
  viewmat: number[];
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
  /** Near plane, in world units. */
  near: number;
}
