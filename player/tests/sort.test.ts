import assert from "node:assert/strict";
import { test } from "node:test";
import { DepthSorter } from "../src/sort";

const axis: [number, number, number, number] = [0, 0, 1, 0];

function sorted(sorter: DepthSorter): number[] {
  const { order, count } = sorter.sort(null);
  return [...order.subarray(0, count)];
}

test("far to near, without the hidden and those behind the camera", () => {
  const sorter = new DepthSorter();
  sorter.reset(5);
  const means = Float32Array.of(0, 0, 1, 0, 0, 5, 0, 0, 3, 0, 0, -2, 0, 0, 4);
  sorter.addLayer({ base: 100, means }, Uint8Array.of(3, 1, 0, 3, 2), axis, 0.01);
  assert.deepEqual(sorted(sorter), [101, 104, 100]);
});

test("moving points sort by where they are between two frames", () => {
  const sorter = new DepthSorter();
  const dx = Uint16Array.of(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 100, 0, 0, 0, 0, 0);
  const group = { base: 0, means: Float32Array.of(0, 0, 5, 0, 0, 8), frames: 2, dx, dxMin: [0, 0, 0], dxStep: [1, 1, 0.1], alive: new Uint8Array() };
  sorter.reset(2);
  sorter.addGroup(group, 0.2, axis, 0.01);
  assert.deepEqual(sorted(sorter), [1, 0]);
  sorter.reset(2);
  sorter.addGroup(group, 0.5, axis, 0.01);
  assert.deepEqual(sorted(sorter), [0, 1]);
  sorter.reset(2);
  sorter.addGroup(group, 1, axis, 0.01);
  assert.deepEqual(sorted(sorter), [0, 1]);
});

test("nothing and equal depths are fine", () => {
  const sorter = new DepthSorter();
  sorter.reset(0);
  assert.deepEqual(sorted(sorter), []);
  sorter.reset(2);
  sorter.addLayer({ base: 0, means: Float32Array.of(0, 0, 1, 0, 0, 1) }, null, axis, 0.01);
  assert.deepEqual(sorted(sorter), [0, 1]);
});
