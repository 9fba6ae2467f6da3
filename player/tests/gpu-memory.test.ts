import assert from "node:assert/strict";
import { test } from "node:test";
import { RowAllocator } from "../packages/renderer/src/webgl/gpu-memory";
import { depthOf, float, hitsAt } from "../packages/renderer/src/webgl/webgl-renderer";
import { half } from "../packages/renderer/src/draw/point-words";

test("ranges do not overlap, gaps are filled first, and an empty range takes no rows", () => {
  const rows = new RowAllocator();
  assert.deepEqual([rows.take(3), rows.take(2), rows.take(0), rows.take(4)], [0, 3, 0, 5]);
  assert.equal(rows.end, 9);
  rows.give(3, 2);
  assert.equal(rows.take(3), 9);
  assert.equal(rows.take(2), 3);
  rows.give(9, 3);
  assert.equal(rows.end, 9);
});

const pair = (low: number, high: number): number => (half(low) | (half(high) << 16)) >>> 0;
const bits = (value: number): number => new Uint32Array(Float32Array.of(value).buffer)[0];

test("half-precision numbers make the round trip", () => {
  for (const value of [0, 1, -1, 0.5, 1.5, -2.25, 1024, 2 ** -20]) assert.equal(float(half(value)), value);
});

test("a splat is hit inside of its ellipse", () => {
  const shape = Uint32Array.of(bits(10), bits(20), pair(6, 0), pair(0, 3));
  const color = Uint32Array.of(0, pair(0, 0.75), bits(3), bits(7));
  assert.deepEqual(hitsAt(shape, color, 10, 20), [{ depth: 7, alpha: 0.75 }]);
  assert.ok(Math.abs(hitsAt(shape, color, 12, 20)[0].alpha - 0.75 * Math.exp(-0.5)) < 1e-6);
  assert.deepEqual(hitsAt(shape, color, 10, 24), []);
});

test("the picked depth is where half of the light is absorbed", () => {
  assert.equal(
    depthOf(
      [
        { depth: 5, alpha: 0.9 },
        { depth: 2, alpha: 0.3 },
        { depth: 3, alpha: 0.4 },
      ],
      0.5,
    ),
    3,
  );
  assert.equal(depthOf([{ depth: 2, alpha: 0.3 }], 0.5), null);
  assert.equal(depthOf([{ depth: 2, alpha: 0.3 }], 0.2), 2);
});
