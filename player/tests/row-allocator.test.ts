import assert from "node:assert/strict";
import { test } from "node:test";
import { RowAllocator } from "../packages/renderer/src/webgl/gpu-memory";

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
