import assert from "node:assert/strict";
import { test } from "node:test";
import { dot, length, subtract, type Vec3 } from "../packages/decoder/src/base/matrix";
import type { Camera, Manifest } from "../packages/decoder/src/reel/manifest";
import { type Motion, STILL } from "../packages/element/src/camera/motion";
import { OrbitCamera } from "../packages/element/src/camera/orbit-camera";
import { Walker } from "../packages/element/src/ui/walk-mode";
import { MANIFEST, manifestOf } from "./fakes/scene";

const UP: Vec3 = [0, -1, 0];

function walk(limits: object | null = null): {
  camera: OrbitCamera;
  walker: Walker;
  pass(seconds: number, keys?: Partial<Motion>): boolean;
} {
  const manifest = manifestOf(limits);
  const camera = new OrbitCamera(manifest);
  const walker = (camera.driver = new Walker(manifest, false));
  const pass = (seconds: number, keys: Partial<Motion> = {}): boolean => {
    camera.steer({ ...STILL, ...keys });
    let moved = false;
    for (let i = 0; i < 60 * seconds; i++) moved = camera.step(1 / 60);
    return moved;
  };
  return { camera, walker, pass };
}

const forward = (camera: OrbitCamera): Vec3 => camera.viewmat.slice(8, 11) as Vec3;
const right = (camera: OrbitCamera): Vec3 => camera.viewmat.slice(0, 3) as Vec3;

test("a walk goes 1.4 m per second, by the size of the capture, and comes to rest", () => {
  const { camera, pass } = walk();
  const start = camera.state.eye;
  pass(1, { forward: 0.6 });
  pass(2);
  const way = subtract(camera.state.eye, start);
  assert.ok(Math.abs(length(way) - 2.8) < 0.1, `${length(way)} units are 1.4 m`);
  assert.ok(way[2] > 2.7, "ahead");
  assert.equal(pass(1), false, "nothing moves any more");
});

test("people look around from where they stand, and keep walking level without a roll", () => {
  const { camera, walker, pass } = walk();
  const { eye } = camera.state;
  walker.look(Math.PI / 2, -0.5); // to the right, and up
  pass(0.1);
  assert.ok(length(subtract(camera.state.eye, eye)) < 1e-9);
  assert.ok(forward(camera)[0] > 0.8 && dot(forward(camera), UP) > 0.4);
  pass(0.5, { forward: 0.6 });
  const way = subtract(camera.state.eye, eye);
  assert.ok(way[0] > 0.5 && Math.abs(way[1]) < 1e-9, `level: ${way}`);
  assert.ok(Math.abs(dot(right(camera), UP)) < 1e-9, "no roll");
});

test("the stick walks as the keys do, and slower if it is half deflected", () => {
  const ways = [1, 0.5].map((part) => {
    const { camera, walker, pass } = walk();
    const { eye } = camera.state;
    walker.stick = [part, 0];
    pass(1);
    return subtract(camera.state.eye, eye)[0];
  });
  assert.ok(ways[0] > 2 && Math.abs(ways[1] / ways[0] - 0.5) < 0.05, `${ways}`);
});

test("the limits hold, softly, and the view does not turn", () => {
  const { camera, pass } = walk({ focus: [0, 0, 0], distance: [1, 5], angle: 180, floor: -0.5 });
  pass(4, { forward: -0.6, down: 0.6 });
  pass(3);
  assert.ok(length(camera.state.eye) < 5.01, `${length(camera.state.eye)}`);
  assert.ok(dot(camera.state.eye, UP) >= -0.51, "above the floor");
  assert.deepEqual(
    forward(camera).map((value) => Math.round(1e6 * value) + 0),
    [0, 0, 1e6],
  );
});

test("keys that reset and visit still move the camera, and orbits return after the walk", () => {
  const { camera, pass } = walk();
  pass(1, { right: 0.6 });
  pass(2);
  camera.reset();
  pass(1);
  assert.ok(length(subtract(camera.state.eye, [0, 0, -4])) < 1e-6);
  camera.driver = null;
  camera.orbit(0.3, 0);
  assert.ok(Math.abs(length(camera.state.eye) - 4) < 1e-6, "about the middle");
});
