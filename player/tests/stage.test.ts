import assert from "node:assert/strict";
import { test } from "node:test";
import { isOrderedFor } from "../packages/renderer/src/draw/stage";

const manifest = {
  overlap: 5,
  first: 0,
  pages: [],
  groups: [
    { firstFrame: 0, frames: 35 },
    { firstFrame: 30, frames: 35 },
  ],
} as never;
const scene = (group: number, frame: number, previous: number | null) => ({
  layers: ["layer"],
  current: { group, frame },
  previous: previous === null ? null : { group: previous, frame: 30 },
});

test("a sort order serves later frames of its groups", () => {
  assert.equal(isOrderedFor(scene(1, 10, null), 45, manifest), true);
  assert.equal(isOrderedFor(scene(1, 0, 0), 32, manifest), true);
  assert.equal(isOrderedFor(scene(0, 20, null), 33, manifest), true, "the next group's waits for its own");
});

test("a loop within a group waits for a new sort order", () => {
  assert.equal(isOrderedFor(scene(1, 20, null), 30, manifest), false, "its group before is missing");
  assert.equal(isOrderedFor(scene(1, 20, 0), 31, manifest), false, "it is in the order of a later frame");
  assert.equal(isOrderedFor(scene(0, 20, null), 3, manifest), false);
  assert.equal(isOrderedFor(scene(0, 20, null), 50, manifest), false);
});
