import assert from "node:assert/strict";
import { test } from "node:test";
import {
  firstFrameOf,
  groupAt,
  missingPages,
  momentAt,
  type Schedule,
  staticFlags,
  staticWeights,
  weightAt,
} from "../packages/decoder/src/reel/timeline";
import { BandwidthMeter } from "../packages/decoder/src/stream/decoder-pool";
import { type Option, RenditionPolicy } from "../packages/decoder/src/stream/rendition-policy";

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

/** Groups of a second at 4, 2 and 1 Mbit/s, with fewer points in the last. */
const OPTIONS: Option[] = [
  { bytes: 500_000, points: 20_000 },
  { bytes: 250_000, points: 20_000 },
  { bytes: 125_000, points: 12_000 },
];

interface World {
  /** Bits a second at a time in seconds. */
  network: (time: number) => number;
  /** Seconds until the first byte. */
  latency?: number;
  /** Milliseconds a point. */
  decode?: number;
  groups?: number;
}

/** Plays groups one after the other over a network; the options taken, and how long it stood still after the first picture. */
function play({ network, latency = 0.03, decode = 0.001, groups = 40 }: World): { taken: number[]; stalled: number } {
  const chooser = new RenditionPolicy();
  const meter = new BandwidthMeter();
  const taken: number[] = [];
  let [time, shown, stalled] = [0, 0, 0]; // seconds; what was shown of the reel
  let started = false;
  const pass = (seconds: number): void => {
    time += seconds;
    if (!started) return;
    const moved = Math.min(seconds, taken.length - shown);
    shown += moved;
    stalled += seconds - moved;
  };
  for (let group = 0; group < groups; group++) {
    while (group - shown > 8) pass(0.05); // enough in store
    const last = taken.at(-1) ?? null;
    const choice = chooser.choose({
      options: OPTIONS,
      seconds: 1,
      ahead: group - shown,
      throughput: meter.rate,
      decode: last === null ? 0 : decode,
      last,
    });
    meter.begin(1000 * time);
    pass(latency);
    for (let left = 8 * OPTIONS[choice].bytes; left > 0;) {
      const came = Math.min(network(time) * 0.02, left);
      pass(0.02);
      left -= came;
      meter.addBytes(came / 8, 1000 * time);
    }
    meter.end(1000 * time);
    pass((decode * OPTIONS[choice].points) / 1000);
    taken.push(choice);
    started = true;
  }
  return { taken, stalled };
}

const switches = (taken: number[]): number => taken.filter((choice, i) => i > 0 && choice !== taken[i - 1]).length;

test("a fast network gets the best rendition within two groups, and keeps it", () => {
  const { taken, stalled } = play({ network: () => 20e6 });
  assert.deepEqual([...new Set(taken.slice(2))], [0]);
  assert.equal(stalled, 0);
});

test("a slow network gets the lowest rendition, and plays without a stall if it can carry that", () => {
  const { taken, stalled } = play({ network: () => 1.6e6 });
  assert.deepEqual([...new Set(taken.slice(2))], [2]);
  assert.ok(stalled < 1, `${stalled} s`);
});

test("a network too slow for every rendition gets the lowest", () => {
  assert.deepEqual([...new Set(play({ network: () => 3e5, groups: 8 }).taken.slice(1))], [2]);
});

test("when bandwidth drops and recovers, the rendition follows without a stall", () => {
  const { taken, stalled } = play({ network: (time) => (time > 10 && time < 20 ? 1.4e6 : 12e6), groups: 60 });
  assert.equal(taken[6], 0);
  assert.equal(Math.max(...taken), 2);
  assert.equal(taken.at(-1), 0);
  assert.equal(stalled, 0);
  assert.ok(switches(taken) <= 6, taken.join(""));
});

test("bandwidth that oscillates around a rendition's rate does not make the rendition oscillate", () => {
  const { taken, stalled } = play({ network: (time) => 4.2e6 * (1 + 0.25 * Math.sin(2 * time)), groups: 120 });
  assert.equal(stalled, 0);
  assert.ok(switches(taken) <= 8, taken.join(""));
});

test("a network of high latency is chosen for correctly", () => {
  const { taken, stalled } = play({ network: () => 8e6, latency: 0.5 });
  assert.ok(stalled < 1, `${stalled} s`);
  assert.ok(Math.max(...taken.slice(5)) <= 1, taken.join(""));
});

test("a slow decoder gets fewer points", () => {
  const { taken } = play({ network: () => 50e6, decode: 0.04 });
  assert.deepEqual([...new Set(taken.slice(1))], [2]);
});

test("a slow renderer gets fewer points, and a new trial from time to time", () => {
  const chooser = new RenditionPolicy();
  const choose = (): number =>
    chooser.choose({ options: OPTIONS, seconds: 1, ahead: 8, throughput: 50e6, decode: 0, last: 0 });
  chooser.judge(true, OPTIONS, 0, 0);
  assert.equal(choose(), 2, "the second has as many points as the first");
  chooser.judge(true, OPTIONS, 2, 1000);
  chooser.judge(false, OPTIONS, 2, 15_000);
  assert.equal(choose(), 2);
  chooser.judge(false, OPTIONS, 2, 21_000);
  assert.equal(choose(), 1);
});

test("a renderer that is slow with any rendition keeps the best", () => {
  const chooser = new RenditionPolicy();
  const options = OPTIONS.map(({ bytes }) => ({ bytes, points: 20_000 }));
  chooser.judge(true, options, 0, 0);
  assert.equal(chooser.choose({ options, seconds: 1, ahead: 8, throughput: 50e6, decode: 0, last: 0 }), 0);
});
