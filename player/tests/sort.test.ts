import assert from "node:assert/strict";
import { test } from "node:test";
import { DepthRun, merge } from "../src/sort";

const axis: [number, number, number, number] = [0, 0, 1, 0];

function sorted(...runs: DepthRun[]): number[] {
  for (const run of runs) run.sort();
  const { order, count } = merge(runs[0], runs[1] ?? new DepthRun(), null);
  assert.ok(order.subarray(count, Math.ceil(count / 1024) * 1024).every((id) => id === 2 ** 32 - 1));
  return [...order.subarray(0, count)];
}

test("far to near, without the hidden and those behind the camera", () => {
  const sorter = new DepthRun();
  sorter.reset(5);
  const means = Float32Array.of(0, 0, 1, 0, 0, 5, 0, 0, 3, 0, 0, -2, 0, 0, 4);
  sorter.addLayer({ base: 100, means }, Uint8Array.of(3, 1, 0, 3, 2), axis, 0.01);
  assert.deepEqual(sorted(sorter), [101, 104, 100]);
});

test("moving points sort by where they are between two frames", () => {
  const sorter = new DepthRun();
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
  const sorter = new DepthRun();
  sorter.reset(0);
  assert.deepEqual(sorted(sorter), []);
  sorter.reset(2);
  sorter.addLayer({ base: 0, means: Float32Array.of(0, 0, 1, 0, 0, 1) }, null, axis, 0.01);
  assert.deepEqual(sorted(sorter), [0, 1]);
});

test("static and moving points together are far to near, however they are merged", () => {
  const random = (seed: number) => () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const next = random(7);
  for (const [m, n] of [[3000, 700], [0, 50], [50, 0], [1, 1]]) {
    const means = [m, n].map((count) => Float32Array.from({ length: 3 * count }, () => 1 + 9 * next()));
    const runs = means.map((values, i) => {
      const run = new DepthRun();
      run.reset(values.length / 3);
      run.addLayer({ base: i * m, means: values }, null, axis, 0.01);
      return run;
    });
    const all = [...means[0], ...means[1]];
    const order = sorted(...runs);
    assert.deepEqual([...order].sort((a, b) => a - b), Array.from({ length: m + n }, (_, i) => i));
    for (let i = 1; i < order.length; i++) assert.ok(all[3 * order[i] + 2] <= all[3 * order[i - 1] + 2] + 0.02);
  }
});
