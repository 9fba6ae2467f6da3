/** Views of a reel through cameras and rays of three.js. */
import {
  add,
  cross,
  dot,
  length,
  normalize,
  scale as scaled,
  subtract,
  type Vec3,
  viewmatOf,
} from "@splatreel/decoder/internal";
import { type View, viewOfModel } from "@splatreel/renderer";
import { Matrix4, type Camera, type OrthographicCamera, type Ray } from "three";

/** Distance, in sizes of the scene, from which an orthographic camera sees it. Parallels are then off by a pixel in 2000. */
const FAR_AWAY = 2000;

const toCamera = new Matrix4();

/** A camera as a view of the reel. */
export interface CameraView {
  view: View;
  /** Depth in clip space from the depth w in the view, in units of the reel: depth[0] + depth[1] / w + depth[2] * (w - depth[3]). */
  depth: [number, number, number, number];
  /** Pixels per unit of slope, for rays. */
  focal: number;
}

/** What is known of a reel: its near plane and the corners of its box, in its units. */
interface Extent {
  near: number;
  bounds: readonly [Vec3, Vec3];
}

/** Return the view of a reel in the units of the reel. scale: of the reel in the scene. */
export function viewOf(
  camera: Camera,
  matrixWorld: Matrix4,
  scale: number,
  width: number,
  height: number,
  { near, bounds: [low, high] }: Extent,
): CameraView {
  toCamera.multiplyMatrices(camera.matrixWorldInverse, matrixWorld);
  const P = camera.projectionMatrix.elements;
  const clip = (camera as { near?: number }).near ?? 0;
  const view = viewOfModel(toCamera.elements, scale, P, width, height, near, clip);
  if (!(camera as Partial<OrthographicCamera>).isOrthographicCamera)
    return { view, depth: [-P[10], P[14] / scale, 0, 0], focal: view.fx };
  // Splats are projected by a perspective camera far behind the orthographic one, which shows the middle of the scene at the same size.
  const [m, size] = [view.viewmat, length(subtract(high, low)) / 2];
  const middle = dot([m[8], m[9], m[10]], scaled(add(low, high), 0.5)) + m[11];
  const back = FAR_AWAY * size - middle;
  const pixels = [(P[0] * width * scale) / 2, (P[5] * height * scale) / 2];
  const far: View = {
    viewmat: m.map((value, i) => (i === 11 ? value + back : value)),
    fx: pixels[0] * FAR_AWAY * size,
    fy: pixels[1] * FAR_AWAY * size,
    cx: ((1 + P[12]) * width) / 2,
    cy: ((1 - P[13]) * height) / 2,
    width,
    height,
    near: back + clip / scale,
  };
  return { view: far, depth: [P[14], 0, -P[10] * scale, back], focal: pixels[0] * Math.max(middle, size) };
}

/** Return a view along a ray in the reel's space, through the corner of four pixels. focal: pixels per unit of slope. */
export function viewAlong(ray: Ray, focal: number, near: number): View {
  const forward = ray.direction.toArray() as Vec3;
  const right = normalize(cross(Math.abs(forward[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], forward));
  const viewmat = viewmatOf(ray.origin.toArray() as Vec3, right, cross(forward, right), forward);
  return { viewmat, fx: focal, fy: focal, cx: 1, cy: 1, width: 2, height: 2, near };
}
