/** What a view sees, for leaving out of the order what it does not. */
import type { View } from "./renderer";

/** Beyond the picture's borders, as a part of its size: the view may turn while it is being sorted for. */
const MARGIN = 0.1;
/** As far as slopes are followed when splats are projected, from the picture's middle: 1.3 times to its border. */
const LARGEST_SLOPE = 1.3;
/** Standard deviations to where the strongest splat ends, at an alpha of 1/100. */
export const EXTENT = Math.sqrt(2 * Math.log(100));

export interface Frustum {
  /** World to camera, [3, 4] row by row. */
  viewmat: number[];
  near: number;
  /** Slopes x / z and y / z at the borders, margins included. */
  left: number;
  right: number;
  top: number;
  bottom: number;
  /** How far a splat of radius 1 at depth 1 may reach, in slopes. */
  reachX: number;
  reachY: number;
}

export function frustumOf({ viewmat, fx, fy, cx, cy, width, height, near }: View): Frustum {
  const [left, right] = [-(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx];
  const [top, bottom] = [-(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy];
  const reach = (low: number, high: number): number => Math.hypot(1, LARGEST_SLOPE * Math.max(-low, high));
  return { viewmat: viewmat.slice(0, 12), near, left, right, top, bottom, reachX: reach(left, right), reachY: reach(top, bottom) };
}
