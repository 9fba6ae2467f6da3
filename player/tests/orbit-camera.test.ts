import assert from "node:assert/strict";
import { test } from "node:test";
import { eyeOf, length, subtract, type Vec3 } from "../packages/decoder/src/base/matrix";
import { OrbitCamera } from "../packages/element/src/camera/orbit-camera";
import type { Manifest } from "../packages/decoder/src/reel/manifest";
import { CAMERA, close, MANIFEST } from "./fakes/scene";
import { reachable } from "../packages/element/src/camera/reachable";
import { manifestOf } from "./fakes/reel";
import { axesOf, normalized, type Quat, quatOf, slerp } from "../packages/element/src/base/quaternion";
import { linkTo, startOf } from "../packages/element/src/camera/link";

const { viewmat } = CAMERA;

/** Where a world point appears in a 160 x 120 picture. */
function pixel(camera: OrbitCamera, point: Vec3): [number, number] {
  const { viewmat: m, fx, fy, cx, cy } = camera.view(160, 120);
  const [x, y, z] = [0, 4, 8].map((r) => m[r] * point[0] + m[r + 1] * point[1] + m[r + 2] * point[2] + m[r + 3]);
  return [(fx * x) / z + cx, (fy * y) / z + cy];
}

test("starts exactly at the reel's camera", () => {
  const view = new OrbitCamera(MANIFEST).view(160, 120);
  close(view.viewmat, viewmat);
  close([view.fx, view.fy, view.cx, view.cy], [120, 120, 80, 60]);
});

test("orbiting keeps the pivot in place and the distance to it", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.orbit(0.7, -0.4);
  close(pixel(camera, [0, 0, 0]), [80, 60]);
  assert.ok(Math.abs(length(eyeOf(camera.viewmat)) - 4) < 1e-6);
});

test("the foreground follows the drag", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.orbit(0.1, 0);
  assert.ok(pixel(camera, [0, 0, -1])[0] > 80);
  camera.viewmat = viewmat;
  camera.orbit(0, 0.1);
  assert.ok(pixel(camera, [0, 0, -1])[1] > 60);
});

test("never crosses the pole", () => {
  const camera = new OrbitCamera(MANIFEST);
  for (let i = 0; i < 100; i++) camera.orbit(0, 0.2);
  assert.ok(Math.abs(camera.viewmat[9]) < 1);
  assert.ok(camera.viewmat[5] > 0, "down still points down");
});

test("panning moves the pivot by as many pixels", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.pan(10, -6, 120);
  close(pixel(camera, [0, 0, 0]), [90, 54]);
});

test("zooming changes only the distance, within bounds", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.zoom(0.5);
  close(eyeOf(camera.viewmat), [0, 0, -2]);
  for (let i = 0; i < 100; i++) camera.zoom(0.5);
  assert.ok(length(subtract(eyeOf(camera.viewmat), [0, 0, 0])) > 0.01);
});

test("a flick slows down and stops", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.flick(3, 0);
  let steps = 0;
  while (camera.step(1 / 60)) steps++;
  assert.ok(steps > 10 && steps < 120, String(steps));
});

test("reset glides back, or jumps with reduced motion", () => {
  for (const calm of [false, true]) {
    const camera = new OrbitCamera(MANIFEST, undefined, calm);
    camera.orbit(0.5, 0.2);
    camera.reset();
    let steps = 0;
    while (camera.step(1 / 60)) steps++;
    close(camera.viewmat, viewmat);
    assert.ok(calm ? steps <= 1 : steps > 10, String(steps));
  }
});

test("a key moves the camera while it is down", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.steer({ yaw: 0, pitch: 0, right: 0, down: 0, forward: 0.5, zoom: 0 });
  for (let i = 0; i < 30; i++) camera.step(1 / 60);
  const [, , z] = eyeOf(camera.viewmat);
  assert.ok(z > -4 && z < -2.5, String(z));
  camera.steer(null);
  let steps = 0;
  while (camera.step(1 / 60)) steps++;
  assert.ok(steps < 120);
});

test("a view that is too far returns when the drag ends", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.hold();
  camera.zoom(10);
  camera.step(1 / 60);
  assert.ok(Math.abs(length(eyeOf(camera.viewmat)) - 40) < 1e-6);
  camera.release();
  while (camera.step(1 / 60));
  assert.ok(length(eyeOf(camera.viewmat)) < 6.1);
  close(pixel(camera, [0, 0, 0]), [80, 60]);
});

test("the limits do not change a pose set by the page", () => {
  const camera = new OrbitCamera(MANIFEST);
  const far = [...viewmat.slice(0, 11), 100, 0, 0, 0, 1];
  camera.viewmat = far;
  assert.equal(camera.step(1), false);
  close(camera.viewmat, far);
});

test("focus turns to the point and orbits about it", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.focus([1, 0.5, 4]);
  while (camera.step(1 / 60));
  close(pixel(camera, [1, 0.5, 0]), [80, 60]);
  camera.orbit(0.4, 0.1);
  close(pixel(camera, [1, 0.5, 0]), [80, 60]);
});

test("a screen narrower than the image shows nothing above and below it; a wider one crops little", () => {
  const camera = new OrbitCamera(MANIFEST);
  for (const [width, height] of [
    [390, 844],
    [768, 1024],
    [600, 600],
    [360, 800],
  ]) {
    const { fx, fy, cx, cy } = camera.view(width, height);
    close([(120 * fy) / 120, fx, cx, cy], [height, height, width / 2, height / 2]);
  }
  const wide = camera.view(844, 390);
  assert.ok(Math.abs(wide.fx - 1.4 * 390) < 1e-6);
  assert.equal(camera.view(160, 4000).fx, 4 * 120);
});

test("the own view is recognized", () => {
  const camera = new OrbitCamera(MANIFEST);
  assert.ok(camera.atOwnView);
  camera.viewmat = [...viewmat.slice(0, 11), 5, 0, 0, 0, 1];
  assert.ok(!camera.atOwnView);
  camera.viewmat = viewmat;
  assert.ok(camera.atOwnView);
  camera.orbit(0.01, 0);
  assert.ok(!camera.atOwnView);
});

test("a portrait screen centers the focus and keeps the roll; a landscape screen is unchanged", () => {
  const aside = {
    ...MANIFEST,
    presentation: { limits: { focus: [1, 0.3, 0], angle: null, distance: null, floor: null } },
  } as unknown as Manifest;
  close(new OrbitCamera(aside, { clientWidth: 844, clientHeight: 390 }).viewmat, viewmat);
  const camera = new OrbitCamera(aside, { clientWidth: 390, clientHeight: 844 }, true);
  const { viewmat: m, fx, cx } = camera.view(390, 844);
  const [x, z] = [0, 8].map((r) => m[r] + 0.3 * m[r + 1] + m[r + 3]);
  assert.ok(Math.abs((fx * x) / z + cx - 195) < 1e-6);
  close([camera.center], [(120 / 4 + 80) / 160]);
  close([m[1], m[4], m[5], m[6]], [0, 0, 1, 0]);
  camera.orbit(0.4, 0);
  camera.reset();
  camera.step(1);
  close(camera.viewmat, m);
});

/** Limits of distance from 1 to 8 about the origin, and a floor at its height (up is -y). */
const plain = manifestOf();
const limited = {
  ...plain,
  presentation: {
    ...plain.presentation,
    limits: { focus: [0, 0, 0] as Vec3, angle: null, distance: [1, 8] as [number, number], floor: 0 },
  },
};
const can = (eye: Vec3, distance = 4, manifest = limited): boolean =>
  reachable({ eye, turn: [1, 0, 0, 0], distance }, manifest) !== null;

test("a linked view that a viewer could reach is accepted", () => {
  assert.deepEqual([can([0, 0, -4]), can([0, 0, -8]), can([0, -3, -4])], [true, true, true]);
});

test("a linked view far outside, below the floor or without content is rejected", () => {
  assert.deepEqual(
    [can([0, 0, -100]), can([0, 0.5, -4]), can([0, 0, -4], 1e6), can([NaN, 0, 0])],
    [false, false, false, false],
  );
});

test("without limits, views below the scene and all cameras are rejected", () => {
  assert.deepEqual([can([0, 0.9, -4], 4, plain), can([0, 3, -4], 4, plain)], [true, false]);
});

const turns: Quat[] = [
  [1, 0, 0, 0],
  [0, 1, 0, 0],
  [0, 0, 1, 0],
  [0, 0, 0, 1],
  normalized([0.3, -0.5, 0.7, 0.2]),
  normalized([-0.1, 0.9, 0.2, -0.6]),
];

test("a rotation is recovered from its axis and angle", () => {
  for (const turn of turns)
    for (const [i, axis] of axesOf(turn).entries()) close(axis, axesOf(quatOf(axesOf(turn)))[i], 1e-4);
});

test("interpolation of two rotations takes the shorter way", () => {
  const c = Math.SQRT1_2;
  close(slerp([1, 0, 0, 0], [c, 0, 0, c], 0.5), [Math.cos(Math.PI / 8), 0, 0, Math.sin(Math.PI / 8)], 1e-4);
  close(slerp([1, 0, 0, 0], [-c, 0, 0, -c], 0.5), [Math.cos(Math.PI / 8), 0, 0, Math.sin(Math.PI / 8)], 1e-4);
});

test("a link contains a time and a pose", () => {
  const start = { seconds: 1.25, view: { eye: [1, -2.5, 3] as [number, number, number], turn: turns[4], distance: 4 } };
  const read = startOf(linkTo("https://host/page?src=a#old", start));
  assert.equal(read.seconds, 1.25);
  close([...read.view!.eye, ...read.view!.turn, read.view!.distance], [1, -2.5, 3, ...turns[4], 4], 1e-4);
});

test("missing or invalid parts of a link change nothing", () => {
  for (const end of ["", "#", "#t=x&view=1,2,3", "#view=0,0,0,0,0,0,0,1", "#view=1,2,3,1,0,0,0,nan"]) {
    assert.deepEqual(startOf(`https://host/${end}`), { seconds: null, view: null });
  }
});
