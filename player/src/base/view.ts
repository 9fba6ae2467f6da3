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

/** Return the intrinsics of a projection matrix [16], column-major as in WebGL, in pixels. */
export function intrinsicsOf(P: ArrayLike<number>, width: number, height: number): Pick<View, "fx" | "fy" | "cx" | "cy" | "width" | "height"> {
  return { fx: (P[0] * width) / 2, fy: (P[5] * height) / 2, cx: ((1 - P[8]) * width) / 2, cy: ((1 + P[9]) * height) / 2, width, height };
}
