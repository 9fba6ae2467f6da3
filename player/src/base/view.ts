/** A pinhole view: viewmat [16] world to camera row by row (OpenCV), lens in pixels of a width x height picture. */
export interface View {
  viewmat: number[];
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
  /** Least depth to draw, world units. */
  near: number;
}
