import assert from "node:assert/strict";
import { test } from "node:test";
import { eyeOf } from "../packages/decoder/src/base/matrix";
import { HeadsetSpace } from "../packages/element/src/camera/headset-space";
import type { Camera, Manifest } from "../packages/decoder/src/reel/manifest";
import { CAMERA, close, MANIFEST } from "./fakes/scene";

const VIEWMAT = CAMERA.viewmat;
/** Column by column: an eye at (x, y, z) that looks along -z; a square picture of 90 degrees. */
const eyeAt = (x: number, y: number, z: number): number[] => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, -z, 1];
const PROJECTION = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, -1, 0, 0, -0.2, 0];

test("the viewer stands at the view, with the eyes 1.6 m above the floor", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  assert.equal(room.meters, 0.5); // the cameras' four units are two meters
  const view = room.view(eyeAt(0, 1.6, 0), PROJECTION, 200, 100, 0.01);
  close(view.viewmat, VIEWMAT);
  close([view.fx, view.fy, view.cx, view.cy], [100, 50, 100, 50]);
});

test("a step in the room is a step in the scene, in meters", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  // A meter to the right, half a meter up and a meter ahead of where people began.
  close(eyeOf(room.view(eyeAt(1, 2.1, -1), PROJECTION, 200, 100, 0.01).viewmat), [2, -1, -2]);
});

test("without a floor the eyes are at the view", () => {
  close(new HeadsetSpace(MANIFEST, VIEWMAT, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01).viewmat, VIEWMAT);
});

test("a viewer who looked down stands upright", () => {
  const down = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 4, 0, 0, 0, 1]; // forward is +y, the top of the picture +z
  const { viewmat } = new HeadsetSpace(MANIFEST, down, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01);
  close(viewmat.slice(8, 11), [0, 0, 1]);
  close(viewmat.slice(4, 7), [0, 1, 0]);
});

test("the room follows the reel's up direction, however the camera was rolled", () => {
  const leaning = { ...MANIFEST, up: [0.6, -0.8, 0] } as Manifest;
  const { viewmat } = new HeadsetSpace(leaning, VIEWMAT, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01);
  close(viewmat.slice(4, 7), [-0.6, 0.8, 0]); // the picture's down
  close(viewmat.slice(8, 11), [0, 0, 1]);
});

test("eyes with asymmetric frusta have principal points off the image center", () => {
  const skewed = [...PROJECTION];
  [skewed[8], skewed[9]] = [0.1, -0.2];
  const { cx, cy } = new HeadsetSpace(MANIFEST, VIEWMAT, true).view(eyeAt(0, 1.6, 0), skewed, 200, 100, 0.01);
  close([cx, cy], [90, 40]);
});

test("points go to the world and back", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  close(room.worldOf([0, 1.6, 0]), [0, 0, -4]);
  close(room.worldOf([1, 0.6, -2]), [2, 2, 0]);
  close(room.pointOf([2, 2, 0]), [1, 0.6, -2]);
});

test("the reel turns and scales about a point, which moves to another", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  const [held, ahead] = [
    [0, 1.6, -2],
    [0.5, 1, -1],
  ] as [number, number, number][];
  const middle = room.worldOf(held);
  const right = room.worldOf([1, 1.6, -2]); // a meter beside it
  room.transform(2, Math.PI / 2, held, ahead);
  assert.equal(room.meters, 1);
  close(room.pointOf(middle), ahead);
  close(room.pointOf(right), [0.5, 1, -3]); // counterclockwise, as seen from above, and two meters away
  close(room.worldOf(room.pointOf(right)), right);
});

test("a reel grows and shrinks by a factor of 50 at most", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  room.transform(1e6, 0, [0, 0, 0], [0, 0, 0]);
  assert.equal(room.meters, 25);
  room.transform(1e-9, 0, [0, 0, 0], [0, 0, 0]);
  assert.equal(room.meters, 0.01);
});
