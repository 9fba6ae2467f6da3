import assert from "node:assert/strict";
import { test } from "node:test";
import type { Keyframe } from "../packages/element/src/camera/camera-path";
import { appended, lasting, moved, throughViews, without } from "../packages/element/src/ui/path-panel";

const keys = (...at: number[]): Keyframe[] => at.map((seconds) => ({ at: seconds, time: 0, viewmat: [seconds] }));
const seconds = (keyframes: Keyframe[]): number[] => keyframes.map(({ at }) => at);

test("a new keyframe is as much later as the reel's time, or by a fixed step", () => {
  let all = appended([], 3, [0]);
  all = appended(all, 4.5, [1]);
  all = appended(all, 4.5, [2]);
  all = appended(all, 1, [3]);
  assert.deepEqual(seconds(all), [0, 1.5, 3.5, 5.5]);
  assert.deepEqual(
    all.map(({ time }) => time),
    [3, 4.5, 4.5, 1],
  );
});

test("after removal of the first keyframe the path begins at 0 again", () => {
  assert.deepEqual(seconds(without(keys(0, 2, 5), 0)), [0, 3]);
  assert.deepEqual(seconds(without(keys(0, 2, 5), 1)), [0, 5]);
  assert.deepEqual(without(keys(0), 0), []);
});

test("moving a keyframe moves the later ones too, and keeps the order", () => {
  assert.deepEqual(seconds(moved(keys(0, 2, 5), 1, 3)), [0, 3, 6]);
  assert.deepEqual(seconds(moved(keys(0, 2, 5), 2, 0)), [0, 2, 2.1]);
});

test("the whole path lasts as long as requested, at least a tenth of a second per leg", () => {
  assert.deepEqual(seconds(lasting(keys(0, 2, 5), 10)), [0, 4, 10]);
  assert.ok(seconds(lasting(keys(0, 2, 5), 0)).every((at, i, all) => i === 0 || at > all[i - 1]));
  assert.deepEqual(lasting(keys(0), 10), keys(0));
});

test("a path through views follows the reel's pace where that is slow enough", () => {
  assert.deepEqual(
    throughViews([[0], [1], [2]], 0, 10).map(({ at, time }) => [at, time]),
    [
      [0, 0],
      [5, 5],
      [10, 10],
    ],
  );
  assert.deepEqual(
    throughViews([[0], [1], [2]], 0, 1).map(({ at, time }) => [at, time]),
    [
      [0, 0],
      [2, 0.5],
      [4, 1],
    ],
  );
  assert.deepEqual(seconds(throughViews([[0]], 0, 1)), [0]);
  assert.deepEqual(
    throughViews([[0], [1], [2]], 20, 30).map(({ at, time }) => [at, time]),
    [
      [0, 20],
      [5, 25],
      [10, 30],
    ],
    "the beginning was dropped",
  );
});
