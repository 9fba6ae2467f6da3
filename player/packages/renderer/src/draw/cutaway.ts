/** Points that are left out of the picture, to preview an edit. */
import type { Vec3 } from "@splatreel/decoder/internal";

/** Maximum number of spheres whose points are left out. */
export const MOST_REMOVED = 24;

/** A sphere in world units. */
export interface Sphere {
  center: Vec3;
  radius: number;
}

/** What an edit keeps: points inside of a box and outside of spheres. */
export interface Cutaway {
  /** Low and high corner; null keeps everything. */
  box: [Vec3, Vec3] | null;
  removed: Sphere[];
}
