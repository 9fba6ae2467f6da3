import assert from "node:assert/strict";
import { test } from "node:test";
import { covers, EXTENT, frustumOf } from "../packages/renderer/src/draw/frustum";
import { DepthRun, merge } from "../packages/renderer/src/draw/sort";

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
/** Sees all that is in front of it. */
const ahead = frustumOf({ viewmat: IDENTITY, fx: 1, fy: 1, cx: 500, cy: 500, width: 1000, height: 1000, near: 0.01 });
/** Flags of points that all show. */
const ALL = new Uint8Array(4000).fill(3);
const points = (...means: number[]) => ({ means: Float32Array.from(means), radii: new Float32Array(means.length / 3) });

function sorted(...runs: DepthRun[]): number[] {
  for (const run of runs) run.sort();
  const { order, count } = merge(runs[0], runs[1] ?? new DepthRun(), null);
  assert.ok(order.subarray(count, Math.ceil(count / 1024) * 1024).every((id) => id === 2 ** 32 - 1));
  return [...order.subarray(0, count)];
}

test("points are sorted from far to near, without hidden points and points behind the camera", () => {
  const sorter = new DepthRun();
  sorter.reset(5);
  sorter.addLayer(
    { base: 100, ...points(0, 0, 1, 0, 0, 5, 0, 0, 3, 0, 0, -2, 0, 0, 4) },
    Uint8Array.of(3, 1, 0, 3, 2),
    ahead,
  );
  assert.deepEqual(sorted(sorter), [101, 104, 100]);
});

test("static points are drawn beyond the clearance, moving points beyond the near plane", () => {
  const view = {
    viewmat: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1],
    fx: 1,
    fy: 1,
    cx: 500,
    cy: 500,
    width: 1000,
    height: 1000,
    near: 0.01,
  };
  const frustum = frustumOf(view, { focus: [0, 0, 4], share: 0.3 }); // the focus is five units deep: 1.5 units are clear
  const [still, moving] = [new DepthRun(), new DepthRun()];
  for (const run of [still, moving]) run.reset(3);
  const row = points(0, 0, 0.1, 0, 0, 0.4, 0, 0, 0.6);
  still.addLayer({ base: 0, ...row }, ALL, frustum);
  moving.addGroup(
    { base: 3, ...row, frames: 1, dx: new Uint16Array(12), dxMin: [0, 0, 0], dxStep: [1, 1, 1] },
    0,
    frustum,
  );
  assert.deepEqual(sorted(still), [2]);
  assert.deepEqual(sorted(moving), [5, 4, 3]);
  still.reset(3);
  still.addLayer({ base: 0, ...row }, ALL, frustumOf(view, { focus: [0, 0, -4], share: 0.3 }));
  assert.deepEqual(sorted(still), [2, 1, 0]); // the focus is behind
});

test("moving points are sorted by their interpolated positions", () => {
  const sorter = new DepthRun();
  const dx = Uint16Array.of(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 100, 0, 0, 0, 0, 0);
  const group = { base: 0, ...points(0, 0, 5, 0, 0, 8), frames: 2, dx, dxMin: [0, 0, 0], dxStep: [1, 1, 0.1] };
  sorter.reset(2);
  sorter.addGroup(group, 0.2, ahead);
  assert.deepEqual(sorted(sorter), [1, 0]);
  sorter.reset(2);
  sorter.addGroup(group, 0.5, ahead);
  assert.deepEqual(sorted(sorter), [0, 1]);
  sorter.reset(2);
  sorter.addGroup(group, 1, ahead);
  assert.deepEqual(sorted(sorter), [0, 1]);
});

test("no points and equal depths are sorted", () => {
  const sorter = new DepthRun();
  sorter.reset(0);
  assert.deepEqual(sorted(sorter), []);
  sorter.reset(2);
  sorter.addLayer({ base: 0, ...points(0, 0, 1, 0, 0, 1) }, ALL, ahead);
  assert.deepEqual(sorted(sorter), [0, 1]);
});

test("static and moving points are merged from far to near", () => {
  const random = (seed: number) => () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const next = random(7);
  for (const [m, n] of [
    [3000, 700],
    [0, 50],
    [50, 0],
    [1, 1],
  ]) {
    const means = [m, n].map((count) => Float32Array.from({ length: 3 * count }, () => 1 + 9 * next()));
    const runs = means.map((values, i) => {
      const run = new DepthRun();
      run.reset(values.length / 3);
      run.addLayer({ base: i * m, ...points(...values) }, ALL, ahead);
      return run;
    });
    const all = [...means[0], ...means[1]];
    const order = sorted(...runs);
    assert.deepEqual(
      [...order].sort((a, b) => a - b),
      Array.from({ length: m + n }, (_, i) => i),
    );
    for (let i = 1; i < order.length; i++) assert.ok(all[3 * order[i] + 2] <= all[3 * order[i - 1] + 2] + 0.02);
  }
});

test("splats that reach into the image are kept, splats beyond its margin are culled", () => {
  // A camera that looks along x from (-10, 0, 0), as in the shader: the linearized splat's reach about its center.
  const viewmat = [0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 10, 0, 0, 0, 1];
  const [fx, fy, cx, cy, width, height] = [500, 400, 300, 250, 640, 480];
  const view = frustumOf({ viewmat, fx, fy, cx, cy, width, height, near: 0.1 });
  let seed = 3;
  const next = (): number => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const scales = Float32Array.from({ length: 4000 }, () => 0.5 * next() ** 3);
  const means = Float32Array.from({ length: 12000 }, () => 30 * next() - 15);
  const run = new DepthRun();
  run.reset(4000);
  run.addLayer({ base: 0, means, radii: scales.map((scale) => EXTENT * scale) }, ALL, view);
  const kept = new Set(sorted(run));
  let outside = 0;
  for (let i = 0; i < 4000; i++) {
    const [x, y, z] = [-means[3 * i + 1], -means[3 * i + 2], means[3 * i] + 10];
    const slope = [(x / z) * fx, (y / z) * fy].map((value, a) =>
      Math.min(
        Math.max(value, [-cx, -cy][a] - 0.15 * [width, height][a]),
        [width - cx, height - cy][a] + 0.15 * [width, height][a],
      ),
    );
    const reach = [0, 1].map(
      (a) => EXTENT * Math.sqrt((scales[i] ** 2 * ([fx, fy][a] ** 2 + slope[a] ** 2)) / z ** 2 + 0.3),
    );
    const center = [(x / z) * fx + cx, (y / z) * fy + cy];
    const seen = z >= 0.1 && center.every((at, a) => at + reach[a] >= 0 && at - reach[a] <= [width, height][a]);
    if (seen) assert.ok(kept.has(i), `${i} reaches into the picture`);
    else outside++;
  }
  assert.ok(
    outside > 1000 && 4000 - kept.size > 0.6 * outside,
    `${4000 - kept.size} of ${outside} outside were left out`,
  );
});

test("a sort order serves slightly different views", () => {
  const view = { viewmat: IDENTITY, fx: 500, fy: 500, cx: 320, cy: 180, width: 640, height: 360, near: 0.1 };
  const turned = (angle: number) => ({
    ...view,
    viewmat: [Math.cos(angle), 0, -Math.sin(angle), 0, 0, 1, 0, 0, Math.sin(angle), 0, Math.cos(angle), 0, 0, 0, 0, 1],
  });
  const moved = (x: number) => ({ ...view, viewmat: [1, 0, 0, -x, ...IDENTITY.slice(4)] });
  assert.ok(
    covers(view, view, 1) && covers(view, { ...view, fx: 250, fy: 250, cx: 160, cy: 90, width: 320, height: 180 }, 1),
  );
  assert.ok(covers(view, turned(0.05), 2) && covers(view, turned(-0.05), 2));
  assert.ok(!covers(view, turned(0.3), 2) && !covers(view, turned(-0.3), 2) && !covers(view, turned(Math.PI), 2));
  assert.ok(covers(view, moved(0.1), 2) && !covers(view, moved(0.1), 0.5) && !covers(view, moved(-1), 2));
  assert.ok(!covers(view, { ...view, fx: 350, fy: 350 }, 2), "a wider lens");
});
