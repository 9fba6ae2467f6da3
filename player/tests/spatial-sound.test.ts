import assert from "node:assert/strict";
import { test } from "node:test";
import { length, viewmatOf, type Vec3 } from "../packages/decoder/src/base/matrix";
import { placeOf } from "../packages/renderer/src/sound/spatial-sound";

const at = (eye: Vec3): number[] => viewmatOf(eye, [1, 0, 0], [0, 1, 0], [0, 0, 1]);
const manifest = {
  camera: { name: "", width: 1, height: 1, K: [], viewmat: at([0, 0, -4]) },
  bounds: [
    [-1, -1, -1],
    [1, 1, 1],
  ] as [Vec3, Vec3],
};

test("at the start view a sound has distance 1, wherever its position", () => {
  for (const place of [
    [0, 0, 0],
    [3, 1, -9],
    [0, 0, -4],
  ] as Vec3[])
    assert.ok(Math.abs(length(placeOf(place, manifest.camera.viewmat, manifest)) - 1) < 1e-9);
});

test("sound is panned to its side, falls with distance, and never leaves an ear silent", () => {
  const [x, y, z] = placeOf([0, 0, 0], at([-4, 0, -0.1]), manifest);
  assert.ok(x > 0 && y === 0 && z > 0.3 * x);
  assert.ok(length(placeOf([0, 0, 0], at([0, 0, -12]), manifest)) > 2.5);
});

test("walking past the sound causes no jump", () => {
  const place: Vec3 = [0, 0, 0];
  const angles = Array.from({ length: 41 }, (_, i) => placeOf(place, at([(i - 20) / 10, 0, 0]), manifest)).map(
    ([x, , z]) => Math.atan2(x, z),
  );
  const steps = angles.slice(1).map((angle, index) => Math.abs(angle - angles[index]));
  assert.ok(Math.max(...steps) < 0.1);
});
