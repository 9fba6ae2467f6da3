import assert from "node:assert/strict";
import { test } from "node:test";
import { timesOf } from "../packages/element/src/element/media-fragment";

test("times of a fragment are seconds, minutes or hours, with or without an end", () => {
  const cases: [string, number | null, number | null][] = [
    ["a/manifest.json", null, null],
    ["a/manifest.json#t=1.5", 1.5, null],
    ["a/manifest.json#t=1.5,3", 1.5, 3],
    ["a/manifest.json#t=,3", null, 3],
    ["a/manifest.json#t=npt:0:01.5,1:00:00", 1.5, 3600],
    ["a/manifest.json#view=0&t=10s", 10, null],
    ["a/manifest.json?t=4", null, null],
    ["a/manifest.json#t=3,1", 3, null],
    ["a/manifest.json#t=-1", null, null],
    ["a/manifest.json#t=NaN,x", null, null],
  ];
  for (const [address, start, end] of cases) assert.deepEqual(timesOf(address), { start, end }, address);
});
