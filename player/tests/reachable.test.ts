import assert from "node:assert/strict";
import { test } from "node:test";
import type { Vec3 } from "../src/base/matrix";
import { reachable } from "../src/camera/reachable";
import { manifestOf } from "./fakes/reel";

/** Limits of distance from 1 to 8 about the origin, and a floor at its height (up is -y). */
const plain = manifestOf();
const limited = { ...plain, presentation: { ...plain.presentation, limits: { focus: [0, 0, 0] as Vec3, angle: null, distance: [1, 8] as [number, number], floor: 0 } } };
const can = (eye: Vec3, distance = 4, manifest = limited): boolean => reachable({ eye, turn: [1, 0, 0, 0], distance }, manifest) !== null;

test("a view of a link is taken where somebody could have come to it", () => {
  assert.deepEqual([can([0, 0, -4]), can([0, 0, -8]), can([0, -3, -4])], [true, true, true]);
});

test("far outside, below the floor, or about nothing that there is, it is not", () => {
  assert.deepEqual([can([0, 0, -100]), can([0, 0.5, -4]), can([0, 0, -4], 1e6), can([NaN, 0, 0])], [false, false, false, false]);
});

test("without a limit nobody stands below the scene and all cameras", () => {
  assert.deepEqual([can([0, 0.9, -4], 4, plain), can([0, 3, -4], 4, plain)], [true, false]);
});
