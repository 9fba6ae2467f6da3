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
export function intrinsicsOf(
  P: ArrayLike<number>,
  width: number,
  height: number,
): Pick<View, "fx" | "fy" | "cx" | "cy" | "width" | "height"> {
  return {
    fx: (P[0] * width) / 2,
    fy: (P[5] * height) / 2,
    cx: ((1 - P[8]) * width) / 2,
    cy: ((1 + P[9]) * height) / 2,
    width,
    height,
  };
}

/**
 * Return the view of a reel in a scene whose cameras look along -z with y up, in the units of the reel. modelView, projection: [16],
 * column-major; scale: of the reel in the scene; near: of the reel, in its units; nearClip: of the camera, in those of the scene.
 */
export function viewOfModel(
  modelView: ArrayLike<number>,
  scale: number,
  projection: ArrayLike<number>,
  width: number,
  height: number,
  near: number,
  nearClip: number,
): View {
  const sign = [1, -1, -1];
  const viewmat = Array.from({ length: 16 }, (_, i) =>
    i < 12 ? (sign[i >> 2] * modelView[4 * (i & 3) + (i >> 2)]) / scale : modelView[4 * (i & 3) + 3],
  );
  return { viewmat, ...intrinsicsOf(projection, width, height), near: Math.max(near, nearClip / scale) };
}

const COMPARED = ["fx", "fy", "cx", "cy", "width", "height"] as const;

/** Return true if two views show the same. */
export function isSameView(a: View | null, b: View): boolean {
  return (
    a !== null && COMPARED.every((name) => a[name] === b[name]) && a.viewmat.every((value, i) => value === b.viewmat[i])
  );
}
