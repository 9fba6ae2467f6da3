import assert from "node:assert/strict";
import { test } from "node:test";
import { Resolution } from "../packages/renderer/src/playback/resolution";

function draw(resolution: Resolution, pictures: number, interval: number, from = 1): number {
  for (let i = 0; i < pictures; i++) resolution.drawn(true, (from += interval));
  return from;
}

test("a fast device draws every pixel; a slow one draws fewer, at least half of each side", () => {
  const fast = new Resolution();
  draw(fast, 200, 16.7);
  assert.equal(fast.ratio, 1);
  const slow = new Resolution();
  draw(slow, 24, 90);
  assert.ok(slow.ratio < 1);
  draw(slow, 200, 90);
  assert.equal(slow.ratio, 0.5);
  slow.quality = "full";
  assert.equal(slow.ratio, 1);
});

test("finer images are tried again, more rarely after each failure", () => {
  const resolution = new Resolution();
  let now = 1;
  let changes = 0;
  for (let i = 0; i < 60 * 60; i++) {
    const before = resolution.ratio;
    now += before > 0.9 ? 40 : 16.7;
    resolution.drawn(true, now);
    if (resolution.ratio !== before) changes++;
  }
  assert.ok(changes >= 2 && changes < 30, String(changes));
});

test("pauses are not measured", () => {
  const resolution = new Resolution();
  for (let i = 0; i < 100; i++) {
    resolution.drawn(true, 5000 * i);
    resolution.drawn(false, 5000 * i + 16);
  }
  assert.equal(resolution.ratio, 1);
});

test("a very slow device becomes coarse after three images, a known slow one at once", () => {
  const slow = new Resolution();
  draw(slow, 4, 800);
  assert.equal(slow.ratio, 0.5);
  const known = new Resolution();
  known.startCoarse();
  assert.equal(known.ratio, 0.5);
  draw(known, 2000, 16.7);
  assert.equal(known.ratio, 1);
});

test("a still image is drawn once at full resolution", () => {
  const resolution = new Resolution();
  let now = draw(resolution, 30, 90);
  assert.equal(resolution.ratio, 0.5);
  assert.ok(!resolution.becomesStill(now + 100));
  assert.ok(resolution.becomesStill((now += 400)));
  assert.equal(resolution.ratio, 1);
  resolution.drawn(true, (now += 1000)); // the full picture, which took a second
  assert.ok(!resolution.becomesStill(now + 5000));
  resolution.move();
  assert.equal(resolution.ratio, 0.5);
  const { interval } = resolution;
  resolution.drawn(true, now + 900);
  assert.equal(resolution.interval, interval, "the full picture does not count");
  resolution.quality = "half";
  assert.ok(!resolution.becomesStill(now + 9000));
});
