import assert from "node:assert/strict";
import { test } from "node:test";
import { dot, eyeOf, length, subtract, viewmatOf, type Vec3 } from "../packages/decoder/src/base/matrix";
import { axesOf } from "../packages/element/src/base/quaternion";
import { OrbitCamera } from "../packages/element/src/camera/orbit-camera";
import {
  OrbitFrame,
  parseAngle,
  parseFieldOfView,
  parseOrbit,
  parseTarget,
} from "../packages/element/src/camera/orbit-declaration";
import type { CameraState } from "../packages/element/src/camera/pose";
import { close, MANIFEST } from "./fakes/scene";

const AUTO = parseOrbit("auto auto auto");

const frame = (target: Vec3 | null = null): OrbitFrame =>
  new OrbitFrame(MANIFEST, new OrbitCamera(MANIFEST).ownState, target);
const eyeAt = (orbit: string): Vec3 => frame().stateOf(parseOrbit(orbit)).eye;

test("values are parsed with their units", () => {
  close([parseAngle("90deg")!, parseAngle("-.5rad")!], [Math.PI / 2, -0.5]);
  assert.equal(parseAngle("auto"), null);
  assert.deepEqual(parseOrbit(" 0deg  auto 105% ").radius, { value: 1.05, relative: true });
  assert.deepEqual(parseOrbit("0deg auto 2.5m").radius, { value: 2.5, relative: false });
  assert.deepEqual([parseTarget("1 -2.5m 3"), parseTarget("auto")], [[1, -2.5, 3], null]);
  close([parseFieldOfView("45deg")!], [Math.PI / 4]);
});

test("wrong values are refused with the value and the remedy", () => {
  for (const [parse, text, words] of [
    [parseAngle, "45", /"45" is not an angle.*45deg/],
    [parseAngle, "deg", /"deg" is not an angle/],
    [parseOrbit, "45deg 80deg", /"45deg 80deg" must hold three values/],
    [parseOrbit, "45deg 80deg 0", /"0" is not a distance/],
    [parseOrbit, "45deg 80deg -2m", /"-2m" is not a distance/],
    [parseTarget, "1 2", /"1 2" is not a position/],
    [parseTarget, "1 2 x", /"1 2 x" is not a position/],
    [parseFieldOfView, "0deg", /"0deg" is not a field of view/],
    [parseFieldOfView, "200deg", /"200deg" is not a field of view/],
  ] as const)
    assert.throws(() => parse(text), words);
});

test("an orbit of auto is the reel's own view", () => {
  close(eyeAt("auto auto auto"), [0, 0, -4]);
  close(eyeAt("0deg 90deg 100%"), [0, 0, -4]);
});

test("azimuths go counterclockwise from above, inclinations count from above", () => {
  // Up is -y, so that right is +x when looking along z; counterclockwise from above is to the viewer's right.
  close(eyeAt("90deg 90deg 2"), [2, 0, 0]);
  close(eyeAt("180deg 90deg 50%"), [0, 0, 2]);
  close(eyeAt("0deg 45deg 4"), [0, -2 * Math.SQRT2, -2 * Math.SQRT2]);
});

test("the horizon of any orbit is level, and its pivot is the target", () => {
  for (const orbit of ["30deg 0deg 2", "200deg 180deg 3", "-70deg 100deg 1", "10deg 60deg auto"]) {
    const state = frame([0.5, 0.2, 0.1]).stateOf(parseOrbit(orbit));
    const [right, , forward] = axesOf(state.turn);
    assert.ok(Math.abs(dot(right, [0, -1, 0])) < 1e-9);
    close(
      state.eye.map((value, a) => value + state.distance * forward[a]),
      [0.5, 0.2, 0.1],
    );
  }
});

test("bounds hold turns and zooms, also across half a turn", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.bounds = frame().boundsOf(parseOrbit("-30deg 60deg 2"), parseOrbit("30deg 100deg 6"));
  const azimuth = (): number => (180 / Math.PI) * Math.atan2(eyeOf(camera.viewmat)[0], -eyeOf(camera.viewmat)[2]);
  camera.orbit(-2, 0);
  close([azimuth()], [30]);
  camera.orbit(3, 0);
  close([azimuth()], [-30]);
  for (const [factor, distance] of [
    [0.01, 2],
    [100, 6],
  ]) {
    camera.zoom(factor);
    close([length(eyeOf(camera.viewmat))], [distance]);
  }
  camera.bounds = frame().boundsOf(parseOrbit("150deg auto auto"), parseOrbit("210deg auto auto"));
  camera.startAt(frame().stateOf(parseOrbit("170deg auto auto")));
  camera.state = frame().stateOf(parseOrbit("170deg auto auto"));
  camera.orbit(-0.3, 0);
  close([(azimuth() + 360) % 360], [170 + (0.3 * 180) / Math.PI]);
  assert.throws(
    () => frame().boundsOf(parseOrbit("auto 90deg auto"), parseOrbit("auto 45deg auto")),
    /smallest inclination/,
  );
});

test("a declared start is the view of the start and of a reset, unless people have moved the camera", () => {
  const state: CameraState = frame().stateOf(parseOrbit("40deg 80deg 3"));
  const camera = new OrbitCamera(MANIFEST, undefined, true);
  camera.startAt(state);
  close(camera.state.eye, state.eye);
  camera.orbit(0.5, 0);
  const moved = camera.state.eye;
  camera.startAt(frame().stateOf(AUTO));
  close(camera.state.eye, moved);
  camera.reset();
  camera.step(1);
  close(camera.state.eye, [0, 0, -4]);
});

test("a declared field of view is that of any canvas", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.fieldOfView = Math.PI / 2;
  for (const [width, height] of [
    [160, 120],
    [100, 300],
    [400, 100],
  ])
    close([camera.view(width, height).fy], [height / 2]);
});

test("the camera rotates after a rest, and turns back at its bounds", () => {
  const camera = new OrbitCamera(MANIFEST);
  camera.bounds = frame().boundsOf(parseOrbit("-30deg auto auto"), parseOrbit("30deg auto auto"));
  camera.rotate({ speed: 0.5, delay: 1 });
  const seen: number[] = [];
  for (let i = 0; i < 80; i++) {
    camera.step(0.1);
    const [x, , z] = eyeOf(camera.viewmat);
    seen.push(Math.atan2(x, -z));
  }
  close(seen.slice(0, 9), Array(9).fill(0));
  assert.ok(Math.max(...seen) > 0.4 && Math.max(...seen) <= Math.PI / 6 + 1e-9);
  assert.ok(seen.at(-1)! < 0.2, "on its way back");
  camera.orbit(0, 0.01);
  const still = camera.viewmat;
  camera.step(0.1);
  close(eyeOf(camera.viewmat), eyeOf(still));
  const calm = new OrbitCamera(MANIFEST, undefined, true);
  calm.rotate({ speed: 0.5, delay: 0 });
  calm.step(1);
  close(calm.viewmat, viewmatOf([0, 0, -4], [1, 0, 0], [0, 1, 0], [0, 0, 1]));
  assert.ok(length(subtract(eyeOf(calm.viewmat), [0, 0, -4])) < 1e-9);
});
