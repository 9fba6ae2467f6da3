import assert from "node:assert/strict";
import { test } from "node:test";
import { parsePoint, parseTime, placeOfPoint } from "../packages/element/src/ui/annotations";

const view = {
  viewmat: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1],
  fx: 100,
  fy: 100,
  cx: 80,
  cy: 60,
  width: 160,
  height: 120,
  near: 0.1,
};

test("a point has the place at which the picture shows it", () => {
  assert.deepEqual(placeOfPoint(view, [0, 0, 0]), { x: 80, y: 60, depth: 4 });
  assert.deepEqual(placeOfPoint(view, [1, -0.5, -2]), { x: 130, y: 35, depth: 2 });
});

test("points behind the camera or outside of the picture have no place", () => {
  for (const point of [
    [0, 0, -5],
    [0, 0, -4],
    [4, 0, 0],
    [0, -3, 0],
  ] as const)
    assert.equal(placeOfPoint(view, [...point]), null);
});

test("positions and times are parsed, and wrong ones refused with the remedy", () => {
  assert.deepEqual(parsePoint(" 1 -2.5  3e-1 "), [1, -2.5, 0.3]);
  assert.deepEqual(
    [parseTime("1.5 3"), parseTime(undefined)],
    [
      [1.5, 3],
      [-Infinity, Infinity],
    ],
  );
  for (const text of ["", "1 2", "1 2 x", "1 2 3 4"]) assert.throws(() => parsePoint(text), /three numbers/);
  for (const text of ["", "1", "3 1", "a b"]) assert.throws(() => parseTime(text), /start and end/);
});
