import assert from "node:assert/strict";
import { test } from "node:test";
import { segmentAt, spareSegments, wantedSegments } from "../packages/renderer/src/sound/sound-source";

const segments = Array.from({ length: 100 }, (_, index) => ({
  uri: `${index}`,
  bytes: 1,
  sha256: "0".repeat(64),
  start: 2 * index,
  seconds: 2,
}));

test("a time lies in a segment, in a gap, or beyond the end", () => {
  assert.deepEqual(
    [0, 1.99, 2, 199.9, 200, -1].map((time) => segmentAt(segments, time)),
    [0, 0, 1, 99, -1, -1],
  );
  assert.equal(segmentAt([segments[0], segments[2]], 3), -1);
  assert.equal(segmentAt([], 0), -1);
});

test("the next segment is requested first, also across the loop", () => {
  assert.deepEqual(wantedSegments(segments, 5, 4, 0), [2, 3, 4]);
  assert.deepEqual(wantedSegments(segments, 197, 8, null), [98, 99]);
  assert.deepEqual(wantedSegments(segments, 197, 8, 0), [98, 99, 0, 1, 2]);
  assert.deepEqual(wantedSegments(segments, 197, 8, 41), [98, 99, 20, 21, 22], "the beginning was dropped");
  assert.deepEqual(wantedSegments(segments.slice(0, 2), 1, 10, 0), [0, 1]);
});

test("the segment heard longest ago is dropped; the next and the latest are kept", () => {
  const held = new Set([...Array(60).keys()]);
  const spare = spareSegments(segments, [58, 59, 60], (segment) => held.has(Number(segment.uri)));
  assert.deepEqual(spare, [...Array(13).keys()]);
  assert.deepEqual(
    spareSegments(segments, [1, 2], (segment) => Number(segment.uri) < 9),
    [],
  );
});
