import assert from "node:assert/strict";
import { test } from "node:test";
import { mortonOrder } from "../packages/decoder/src/decode/gaussians";

function code(x: number, y: number, z: number): bigint {
  let result = 0n;
  for (let b = 0; b < 21; b++) {
    [x, y, z].forEach((v, a) => (result |= BigInt((v >> b) & 1) << BigInt(3 * b + a)));
  }
  return result;
}

test("sorts by Morton code over all 21 bits", () => {
  const random = lcg(7);
  const q = Array.from({ length: 3 * 500 }, () => Math.floor(random() * 2 ** 21));
  const codes = Array.from(mortonOrder(q), (i) => code(q[3 * i], q[3 * i + 1], q[3 * i + 2]));
  assert.ok(codes.every((value, i) => i === 0 || codes[i - 1] <= value));
  assert.equal(new Set(mortonOrder(q)).size, 500);
});

test("keeps equal points in their order", () => {
  assert.deepEqual([...mortonOrder([5, 5, 5, 0, 0, 0, 5, 5, 5])], [1, 0, 2]);
});

function lcg(seed: number): () => number {
  return () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32;
}
