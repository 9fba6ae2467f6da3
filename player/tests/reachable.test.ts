import assert from "node:assert/strict";
import { test } from "node:test";
import type { Vec3 } from "../packages/decoder/src/base/matrix";
import { reachable } from "../packages/element/src/camera/reachable";
import { manifestOf } from "./fakes/reel";

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
