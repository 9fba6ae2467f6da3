import assert from "node:assert/strict";
import { test } from "node:test";
import { BandwidthMeter } from "../packages/decoder/src/stream/decoder-pool";
import { type Option, RenditionPolicy } from "../packages/decoder/src/stream/rendition-policy";

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
