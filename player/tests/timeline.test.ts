import assert from "node:assert/strict";
import { test } from "node:test";
import { groupAt, momentAt, momentOf, staticFlags, staticWeights } from "../src/reel/timeline";

const groups = [{ firstFrame: 0, frames: 35 }, { firstFrame: 30, frames: 35 }, { firstFrame: 60, frames: 30 }];

test("the current group is the last that has begun", () => {
  const expected: [number, number][] = [[-1, 0], [0, 0], [29.99, 0], [30, 1], [59.5, 1], [60, 2], [500, 2]];
  for (const [frame, group] of expected) assert.equal(groupAt(groups, frame), group, String(frame));
});

test("one group shows alone at full weight", () => {
  assert.deepEqual(momentAt(groups, 5, 30, 0.5), { current: { group: 0, frame: 15 }, previous: null, weight: 1 });
  assert.deepEqual(momentAt(groups, 5, 30, 0), { current: { group: 0, frame: 0 }, previous: null, weight: 1 });
});

test("neighbours cross-fade over the overlap", () => {
  const moment = momentAt(groups, 5, 10, 3.2);
  assert.deepEqual(moment.current, { group: 1, frame: 2 });
  assert.deepEqual(moment.previous, { group: 0, frame: 32 });
  assert.ok(Math.abs(moment.weight - 0.352) < 1e-9);
  assert.equal(momentAt(groups, 5, 10, 3.5).previous, null);
});

test("without overlap nothing fades", () => {
  assert.deepEqual(momentAt(groups, 0, 30, 1), { current: { group: 1, frame: 0 }, previous: null, weight: 1 });
});

test("frames are clamped to what a group holds", () => {
  assert.equal(momentAt(groups, 5, 30, 100).current.frame, 29);
  assert.equal(momentOf(groups, 5, 10, 1).current.frame, 0);
  assert.equal(momentOf(groups, 50, 70, 1).previous?.frame, 34);
});

test("static points: alive in both, new, leaving, gone", () => {
  const flags = staticFlags(4, Uint8Array.of(1, 1, 0, 0), Uint8Array.of(1, 0, 1));
  assert.deepEqual([...flags], [3, 1, 2, 0]);
  assert.deepEqual(Array.from(flags, (flag) => staticWeights(0.25)[flag]), [1, 0.25, 0.75, 0]);
  assert.deepEqual([...staticFlags(3, Uint8Array.of(1, 0), null)], [3, 0, 0]);
});
