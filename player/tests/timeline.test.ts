import assert from "node:assert/strict";
import { test } from "node:test";
import {
  firstFrameOf,
  groupAt,
  missingPages,
  momentAt,
  staticFlags,
  staticWeights,
  weightAt,
  type Schedule,
} from "../packages/decoder/src/reel/timeline";

const three = {
  first: 0,
  pages: [],
  overlap: 5,
  groups: [
    { firstFrame: 0, frames: 35 },
    { firstFrame: 30, frames: 35 },
    { firstFrame: 60, frames: 30 },
  ],
};

/** Groups of ten frames from a first one on: so many in each of two pages, and two after them. Of the pages some are here. */
function paged(first: number, count: number, here: boolean[]): Schedule {
  const pages = here.map((_, i) => ({
    group: first + i * count,
    count,
    firstFrame: 10 * (first + i * count),
    frames: 10 * count + 2,
  }));
  const groups: Schedule["groups"] = [];
  const numbers = [
    ...pages.flatMap(({ group }, i) => (here[i] ? Array.from({ length: count }, (_, k) => group + k) : [])),
    first + 2 * count,
    first + 2 * count + 1,
  ];
  for (const number of numbers) groups[number] = { firstFrame: 10 * number, frames: 12 };
  return { first, pages, groups, overlap: 2 };
}

test("the current group is the last one that has started", () => {
  const expected: [number, number][] = [
    [-1, 0],
    [0, 0],
    [29.99, 0],
    [30, 1],
    [59.5, 1],
    [60, 2],
    [500, 2],
  ];
  for (const [frame, group] of expected) assert.equal(groupAt(three, frame), group, String(frame));
});

test("a single group has full weight", () => {
  assert.deepEqual(momentAt(three, 30, 0.5), { current: { group: 0, frame: 15 }, previous: null, weight: 1 });
  assert.deepEqual(momentAt(three, 30, 0), { current: { group: 0, frame: 0 }, previous: null, weight: 1 });
});

test("neighbors cross-fade over the overlap", () => {
  const moment = momentAt(three, 10, 3.2)!;
  assert.deepEqual(moment.current, { group: 1, frame: 2 });
  assert.deepEqual(moment.previous, { group: 0, frame: 32 });
  assert.ok(Math.abs(moment.weight - 0.352) < 1e-9);
  assert.equal(momentAt(three, 10, 3.5)!.previous, null);
});

test("without an overlap nothing fades, and the first group fades from nothing", () => {
  assert.deepEqual(momentAt({ ...three, overlap: 0 }, 30, 1), {
    current: { group: 1, frame: 0 },
    previous: null,
    weight: 1,
  });
  assert.equal(weightAt({ ...three, first: 1 }, 31, 1), 1);
  assert.ok(weightAt(three, 31, 1) < 1);
});

test("frames are clamped to those of a group", () => {
  assert.equal(momentAt(three, 30, 100)!.current.frame, 29);
  assert.equal(momentAt({ ...three, overlap: 50 }, 1, 70)!.previous?.frame, 34);
});

test("groups keep their numbers wherever the reel begins", () => {
  const schedule = paged(100, 3, [true, true]);
  const expected: [number, number][] = [
    [0, 100],
    [999, 100],
    [1000, 100],
    [1029, 102],
    [1030, 103],
    [1059, 105],
    [1060, 106],
    [9000, 107],
  ];
  for (const [frame, group] of expected) assert.equal(groupAt(schedule, frame), group, String(frame));
  assert.deepEqual(momentAt(schedule, 1, 1021), {
    current: { group: 102, frame: 1 },
    previous: { group: 101, frame: 11 },
    weight: 0.5,
  });
});

test("the visible groups are unknown until their pages are loaded, both pages in a cross-fade at a border", () => {
  const missing = (here: boolean[], frame: number): number[] =>
    missingPages(paged(0, 3, here), frame).map(({ group }) => group);
  assert.deepEqual(
    [missing([false, false], 0), missing([false, false], 25), missing([false, false], 35)],
    [[0], [0], [3]],
  );
  assert.deepEqual(
    [missing([false, false], 31), missing([true, false], 31), missing([false, true], 31), missing([true, true], 31)],
    [[3, 0], [3], [0], []],
  );
  assert.deepEqual(
    [missing([false, false], 61), missing([false, false], 62)],
    [[3], []],
    "the manifest's own groups are here",
  );
  assert.equal(momentAt(paged(0, 3, [false, true]), 1, 31), null);
  assert.deepEqual(momentAt(paged(0, 3, [true, true]), 1, 31)!.previous, { group: 2, frame: 11 });
});

test("pages contain the start of their first groups", () => {
  const schedule = paged(4, 3, [false, true]);
  assert.deepEqual(
    [4, 5, 7, 8, 10, 12].map((group) => firstFrameOf(schedule, group)),
    [40, undefined, 70, 80, 100, undefined],
  );
});

test("static points: alive in both groups, new, leaving, gone", () => {
  const now = { alive: Uint8Array.of(1, 1, 0, 0), layers: ["a", "b"] };
  const counts = new Map([
    ["a", 3],
    ["b", 1],
  ]);
  const listed = (flags: Map<string, Uint8Array>): number[][] => [...flags.values()].map((own) => [...own]);
  const flags = staticFlags(counts, now, { alive: Uint8Array.of(1, 0, 1), layers: ["a"] });
  assert.deepEqual(listed(flags), [[3, 1, 2], [0]]);
  assert.deepEqual(
    Array.from(flags.get("a")!, (flag) => staticWeights(0.25)[flag]),
    [1, 0.25, 0.75],
  );
  assert.deepEqual(listed(staticFlags(counts, { ...now, alive: Uint8Array.of(1, 0) }, null)), [[3, 0, 0], [0]]);
  assert.deepEqual(listed(staticFlags(counts, null, null)), [[3, 3, 3], [3]]);
});

test("in a cross-fade of chapters, each group's bits refer to its own living layers", () => {
  const counts = new Map([
    ["shared", 2],
    ["old", 3],
    ["new", 1],
  ]);
  const now = { alive: Uint8Array.of(1, 0, 1), layers: ["shared", "new"] };
  const before = { alive: Uint8Array.of(1, 1, 0, 1, 1), layers: ["shared", "old"] };
  const flags = staticFlags(counts, now, before);
  assert.deepEqual(
    [...flags].map(([layer, own]) => [layer, ...own]),
    [
      ["shared", 3, 2],
      ["old", 0, 2, 2],
      ["new", 1],
    ],
  );
});

test("a group's own overlap replaces the schedule's, and 0 is a hard cut", () => {
  const [a, b, c] = three.groups;
  const joined = { ...three, groups: [a, { ...b, overlap: 0 }, { ...c, overlap: 10 }] };
  assert.deepEqual(momentAt(joined, 30, 1), { current: { group: 1, frame: 0 }, previous: null, weight: 1 });
  assert.equal(momentAt(joined, 65, 1)!.weight, 0.5);
  assert.equal(momentAt(joined, 70, 1)!.previous, null);
});
