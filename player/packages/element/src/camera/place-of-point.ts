/** Places of points on the picture. */
import type { Vec3 } from "@splatreel/decoder/internal";
import type { View } from "@splatreel/renderer";

/** Position in the pixels of a view, and depth in front of the camera, in world units. */
export interface Place {
  x: number;
  y: number;
  depth: number;
}

/** Return where a view shows a point; null if the point is behind the camera or outside of the picture. */
export function placeOfPoint({ viewmat: m, fx, fy, cx, cy, width, height, near }: View, point: Vec3): Place | null {
  const [x, y, depth] = [0, 4, 8].map(
    (row) => m[row] * point[0] + m[row + 1] * point[1] + m[row + 2] * point[2] + m[row + 3],
  );
  if (depth <= near) return null;
  const place = { x: (fx * x) / depth + cx, y: (fy * y) / depth + cy, depth };
  return place.x >= 0 && place.x <= width && place.y >= 0 && place.y <= height ? place : null;
}
