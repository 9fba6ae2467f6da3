import assert from "node:assert/strict";
import { test } from "node:test";
import {
  dragged,
  edgesOf,
  FACES,
  firstBox,
  marksAt,
  middleOf,
  operationsOf,
  pointAt,
  projected,
  type Box,
} from "../packages/element/src/ui/crop-box";
import type { View } from "../packages/renderer/src/base/view";

const box: Box = [
  [-1, -2, 3],
  [1, 2, 5],
];
const view = {
  viewmat: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1],
  fx: 100,
  fy: 100,
  cx: 50,
  cy: 40,
  width: 100,
  height: 80,
  near: 0.1,
} as View;

test("a box has six faces and twelve edges", () => {
  assert.equal(FACES.length, 6);
  assert.deepEqual(middleOf(box, { axis: 0, side: 1 }), [1, 0, 4]);
  assert.equal(edgesOf(box).length, 12);
  assert.ok(edgesOf(box).every(([a, b]) => a.filter((value, i) => value !== b[i]).length === 1));
});

test("a dragged face follows the pointer along its axis, and does not pass the opposite one", () => {
  const face = { axis: 0, side: 1 as const };
  const before = projected(middleOf(box, face), view)!;
  const moved = dragged(box, face, [10, 0], view);
  const after = projected(middleOf(moved, face), view)!;
  assert.ok(Math.abs(after[0] - before[0] - 10) < 1e-6);
  assert.deepEqual(moved[0], box[0]);
  assert.deepEqual(moved[1].slice(1), box[1].slice(1));
  assert.ok(dragged(box, face, [-1000, 0], view)[1][0] > box[0][0]);
  assert.deepEqual(dragged(box, face, [0, 30], view), box);
});

test("a pixel and a depth give the point that is seen there", () => {
  const point: [number, number, number] = [0.3, -0.2, 4];
  const found = pointAt(projected(point, view)!, 6, view);
  assert.ok(found.every((value, i) => Math.abs(value - point[i]) < 1e-9));
  assert.equal(projected([0, 0, -5], view), null);
});

test("marks of some frames hide nothing at the others", () => {
  const [always, once] = [
    { center: [0, 0, 0], radius: 1, range: null },
    { center: [1, 0, 0], radius: 1, range: [30, 60] },
  ] as const;
  const marks = [always, once] as unknown as Parameters<typeof marksAt>[0];
  assert.deepEqual(
    [29.9, 30, 59.9, 60].map((frame) => marksAt(marks, frame).length),
    [1, 2, 2, 1],
  );
});

test("the operations are those that splatreel edit reads", () => {
  const marks: Parameters<typeof operationsOf>[1] = [{ center: [0.123456789, -1, 2], radius: 0.05, range: [30, 60] }];
  assert.deepEqual(operationsOf(box, marks, true), [
    "remove=sphere:0.12346,-1,2,0.05@30:60",
    "crop=box:-1,-2,3,1,2,5",
    "background=transparent",
  ]);
  assert.deepEqual(operationsOf(null, [], false), []);
});

test("the first box is in front of the viewer and within the bounds", () => {
  assert.deepEqual(
    firstBox(
      [
        [-9, -9, -9],
        [9, 1, 9],
      ],
      [0, 0, 0],
      [0, 0, -4],
    ),
    [
      [-1.2, -1.2, -1.2],
      [1.2, 1, 1.2],
    ],
  );
  assert.ok(
    firstBox(
      [
        [5, 5, 5],
        [6, 6, 6],
      ],
      [0, 0, 0],
      [0, 0, -4],
    )
      .flat()
      .every(Number.isFinite),
  );
});
