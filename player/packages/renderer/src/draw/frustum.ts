/** View frustum, to leave invisible points out of the order. */
import { type Clearance, dot } from "@splatreel/decoder/internal";
import type { View } from "../base/view";

/** Margin around the image, relative to its size, since the view may turn during the sort. */
const MARGIN = 0.1;
/** Largest slope at which splats are projected, relative to the border of the image. */
const LARGEST_SLOPE = 1.3;
/** Standard deviations at which an opaque splat ends, at an alpha of 1/100. */
export const EXTENT = Math.sqrt(2 * Math.log(100));

/** Part of space that a view sees. */
export interface Frustum {
  /** World to camera, [3, 4], row-major. */
  viewmat: number[];
  near: number;
  /** Minimum depth of static points. */
  clear: number;
  /** Slopes x / z and y / z at the borders, margins included. */
  left: number;
  right: number;
  top: number;
  bottom: number;
  /** Maximum extent of a splat of radius 1 at depth 1, as a slope. */
  reachX: number;
  reachY: number;
}

/** Return the frustum of a view. clearance: distance within which static points are hidden. */
export function frustumOf(
  { viewmat, fx, fy, cx, cy, width, height, near }: View,
  clearance: Clearance | null = null,
): Frustum {
  const [left, right] = [-(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx];
  const [top, bottom] = [-(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy];
  const reach = (low: number, high: number): number => Math.hypot(1, LARGEST_SLOPE * Math.max(-low, high));
  const depth = clearance ? dot([viewmat[8], viewmat[9], viewmat[10]], clearance.focus) + viewmat[11] : 0;
  const clear = Math.max(near, (clearance?.share ?? 0) * depth);
  return {
    viewmat: viewmat.slice(0, 12),
    near,
    clear,
    left,
    right,
    top,
    bottom,
    reachX: reach(left, right),
    reachY: reach(top, bottom),
  };
}

/** Return true if the frustum of `sorted` contains all that another view sees at `depth` and beyond. */
export function covers(sorted: View, { viewmat: n, fx, fy, cx, cy, width, height }: View, depth: number): boolean {
  const { viewmat: m, left, right, top, bottom } = frustumOf(sorted);
  return [0, 1, 2, 3].every((corner) => {
    const seen = [
      (((corner & 1) * width - cx) / fx) * depth - n[3],
      (((corner >> 1) * height - cy) / fy) * depth - n[7],
      depth - n[11],
    ];
    const point = [0, 1, 2].map((a) => n[a] * seen[0] + n[4 + a] * seen[1] + n[8 + a] * seen[2]);
    const [x, y, z] = [0, 4, 8].map(
      (row) => m[row] * point[0] + m[row + 1] * point[1] + m[row + 2] * point[2] + m[row + 3],
    );
    return z > 0 && x >= left * z && x <= right * z && y >= top * z && y <= bottom * z;
  });
}
