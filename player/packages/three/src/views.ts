/** Views of a reel through cameras and rays of three.js. */
import { cross, normalize, viewmatOf, type Vec3 } from "@splatreel/decoder/base/matrix";
import { viewOfModel, type View } from "splatreel-player/base/view";
import { Matrix4, type Camera, type Ray } from "three";

const toCamera = new Matrix4();

/** Return the view of a reel in the units of the reel. scale: of the reel in the scene. near: in units of the reel. */
export function viewOf(camera: Camera, matrixWorld: Matrix4, scale: number, width: number, height: number, near: number): View {
  toCamera.multiplyMatrices(camera.matrixWorldInverse, matrixWorld);
  return viewOfModel(toCamera.elements, scale, camera.projectionMatrix.elements, width, height, near, (camera as { near?: number }).near ?? 0);
}

/** Return a view along a ray in the reel's space, through the corner of four pixels. focal: pixels per unit of slope. */
export function viewAlong(ray: Ray, focal: number, near: number): View {
  const forward = ray.direction.toArray() as Vec3;
  const right = normalize(cross(Math.abs(forward[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], forward));
  const viewmat = viewmatOf(ray.origin.toArray() as Vec3, right, cross(forward, right), forward);
  return { viewmat, fx: focal, fy: focal, cx: 1, cy: 1, width: 2, height: 2, near };
}
