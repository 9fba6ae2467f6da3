import assert from "node:assert/strict";
import { test } from "node:test";
import { cross, dot, eyeOf, length, normalize, subtract, type Vec3 } from "../packages/decoder/src/base/matrix";
import { Limits } from "../packages/element/src/camera/limits";
import { OrbitCamera } from "../packages/element/src/camera/orbit-camera";
import type { Manifest } from "../packages/decoder/src/reel/manifest";
import { manifestOf } from "./fakes/scene";

/** Cameras 4 from the origin, before it and to the left and right by 20 degrees; up is -y. */
const lookAt = (eye: Vec3): number[] => {
  const forward = normalize(subtract([0, 0, 0], eye));
  const right = normalize(cross([0, 1, 0], forward));
  const down = cross(forward, right);
  return [right, down, forward].flatMap((axis) => [...axis, -dot(axis, eye)]).concat(0, 0, 0, 1);
};
const place = (degrees: number, height = 0): Vec3 => {
  const angle = (degrees * Math.PI) / 180;
  return [4 * Math.sin(angle), -height, -4 * Math.cos(angle)];
};
const camera = (eye: Vec3) => ({
  name: "",
  width: 160,
  height: 120,
  K: [120, 0, 80, 0, 120, 60, 0, 0, 1],
  viewmat: lookAt(eye),
});
const given = { focus: [0, 0, 0], angle: 15, distance: [1, 8], floor: -0.5 };
const manifest = (limits: object | null): Manifest =>
  manifestOf(limits, [camera(place(0)), ...[-20, 20].map((a) => camera(place(a)))]);
const sideOf = ([x, , z]: Vec3): number => (Math.atan2(x, -z) * 180) / Math.PI;
const settle = (camera: OrbitCamera): Vec3 => {
  for (let i = 0; i < 600 && camera.step(1 / 60); i++);
  return eyeOf(camera.viewmat);
};

test("nothing is moved or faded within the limits", () => {
  const limits = new Limits(manifest(given));
  for (const eye of [place(0), place(30), place(-34), [0, -0.9, -3.9] as Vec3]) {
    assert.ok(length(subtract(limits.eye(eye), eye)) < 1e-9, String(eye));
    assert.equal(limits.fade(eye), 0);
  }
});

test("the nearest allowed pose lies at the limit that was passed", () => {
  const limits = new Limits(manifest(given));
  assert.ok(Math.abs(sideOf(limits.eye(place(80))) - 35) < 1e-6);
  assert.ok(Math.abs(length(limits.eye([0, 0, -20])) - 8) < 1e-9);
  assert.ok(Math.abs(length(limits.eye([0, 0, -0.2])) - 1) < 1e-9);
  assert.ok(Math.abs(limits.eye([0, 3, -4])[1] - 0.5) < 1e-9); // half a unit below the focus, y points down
});

test("images fade with the distance from the captured views, but not without limits or inside of them", () => {
  const limits = new Limits(manifest(given));
  const fades = [36, 50, 65, 90, 180].map((angle) => limits.fade(place(angle)));
  assert.ok(fades[0] > 0 && fades[0] < 0.01);
  for (let i = 1; i < 4; i++) assert.ok(fades[i] > fades[i - 1]);
  assert.ok(fades[4] > 0.9 && fades[4] < 1);
  assert.ok(limits.fade([0, 0, 0.05]) < 0.01);
  assert.equal(new Limits(manifest(null)).fade(place(180)), 0);
});

test("a view beyond the cameras returns when the drag ends, and the horizon stays level", () => {
  const camera = new OrbitCamera(manifest(given));
  camera.hold();
  camera.orbit(-1.5, 0.1);
  camera.step(1 / 60);
  assert.ok(Math.abs(sideOf(eyeOf(camera.viewmat)) - 85.9) < 1);
  assert.ok(camera.offCameraFade > 0.5);
  camera.release();
  assert.ok(Math.abs(sideOf(settle(camera)) - 35) < 0.5);
  assert.ok(camera.offCameraFade < 0.01);
  assert.ok(Math.abs(camera.viewmat[1]) < 1e-6, "right is level");
  const { viewmat: m } = camera;
  assert.ok(length([m[3], m[7], m[11] - 4]) < 0.05, "the middle is still in the middle");
});

test("the camera is lifted above the floor during a drag, and stops at the distance limits", () => {
  const camera = new OrbitCamera(manifest(given));
  camera.hold();
  camera.walk(0, 1, 0);
  const depth = eyeOf(camera.viewmat)[1];
  for (let i = 0; i < 120; i++) camera.step(1 / 60);
  assert.ok(depth > 3.9);
  assert.ok(eyeOf(camera.viewmat)[1] < 0.51);
  camera.release();
  camera.reset();
  settle(camera);
  camera.zoom(10);
  assert.ok(Math.abs(length(settle(camera)) - 8) < 0.05);
});

test("a pose that a page sets is neither moved nor faded", () => {
  const camera = new OrbitCamera(manifest(given));
  const behind = lookAt([0, 2, 30]);
  camera.viewmat = behind;
  assert.equal(camera.step(1), false);
  assert.equal(camera.offCameraFade, 0);
  assert.ok(camera.viewmat.every((value, i) => Math.abs(value - behind[i]) < 1e-9));
});
