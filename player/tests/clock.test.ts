import assert from "node:assert/strict";
import { test } from "node:test";
import { Clock } from "../packages/renderer/src/playback/clock";
import type { Manifest } from "../packages/decoder/src/reel/manifest";
import { Reel } from "../packages/decoder/src/reel/reel";
import type { Page } from "../packages/decoder/src/reel/pages";
import { PlayPromises } from "../packages/renderer/src/playback/play-promises";
import { status } from "./fakes/host";
import { FakePlayer } from "./fakes/player";

function clockOf(live = false): Clock {
  const clock = new Clock();
  const groups = [0, 30, 60].map((firstFrame) => ({ firstFrame, frames: 30 }));
  clock.open(new Reel({ fps: 30, frames: 90, overlap: 5, first: 0, groups, pages: [] as Page[], live } as Manifest));
  return clock;
}

test("time runs at its rate, within 0 and 16", () => {
  const clock = clockOf();
  clock.rate = 0.5;
  assert.equal(clock.advance(1), true);
  assert.equal(clock.seconds, 0.5);
  clock.rate = 99;
  assert.equal(clock.rate, 16);
});

test("time stops at the end, or repeats from the beginning", () => {
  const clock = clockOf();
  clock.advance(9);
  assert.deepEqual([clock.seconds, clock.ended, clock.frame], [3, true, 89]);
  clock.loop = true;
  clock.advance(0.5);
  assert.equal(clock.seconds, 0.5);
});

test("a section repeats once time has reached its end, and another reel forgets it", () => {
  const clock = clockOf();
  clock.section = [1, 1.5];
  clock.advance(1.25);
  assert.equal(clock.seconds, 1.25);
  clock.advance(0.5);
  assert.equal(clock.seconds, 1.25);
  clock.seek(2);
  clock.advance(0.5);
  assert.equal(clock.seconds, 2.5, "time beyond the section goes on");
  clock.section = [2, 9];
  clock.advance(0.75);
  assert.equal(clock.seconds, 2.25, "the end of the reel ends the section");
  for (const section of [
    [1, 1],
    [2, 1],
    [-1, 1],
    [NaN, 1],
  ] as const)
    assert.throws(() => (clock.section = section), TypeError);
  clock.reset();
  assert.equal(clock.section, null);
});

test("a live reel waits at its live edge, or repeats its last group", () => {
  const clock = clockOf(true);
  clock.seek(3);
  assert.equal(clock.advance(1), false);
  assert.equal(clock.ended, false);
  clock.loop = true;
  assert.equal(clock.advance(1), true);
  assert.equal(clock.seconds, 2);
});

test("a reel whose beginning was dropped keeps its times, and loops from its first kept frame", () => {
  const clock = clockOf();
  const groups = Object.assign([], { 1: { firstFrame: 30, frames: 30 }, 2: { firstFrame: 60, frames: 30 } });
  clock.open(new Reel({ ...clock.manifest!, first: 1, groups }));
  assert.deepEqual([clock.earliest, clock.duration], [1, 3]);
  clock.seek(0.2);
  assert.deepEqual([clock.seconds, clock.timeAfter(-5), clock.moment!.previous], [1, 1, null]);
  clock.seek(2.9);
  clock.loop = true;
  clock.advance(0.5);
  assert.ok(Math.abs(clock.seconds - 1.4) < 1e-9);
});

test("steps are whole frames within the reel", () => {
  const clock = clockOf();
  clock.seek(1.01);
  assert.equal(clock.timeAfter(1), 31 / 30);
  assert.equal(clock.timeAfter(-99), 0);
  assert.equal(clock.timeAfter(999), 89 / 30);
  assert.deepEqual([clock.moment!.current.group, clock.moment!.previous?.group], [1, 0]);
});

const { host, time } = FakePlayer;

test("play() resolves once time advances, also for later callers", async () => {
  const fake = new FakePlayer({ groups: 3 });
  const promises = new PlayPromises(fake.player, () => fake.player.play());
  await fake.open();
  let played = 0;
  const first = promises.play().then(() => played++);
  const second = promises.play().then(() => played++);
  await fake.pass(200);
  assert.equal(played, 0);
  fake.files.giveAll();
  await fake.pass(200);
  await Promise.all([first, second]);
  await promises.play();
  assert.equal(played, 2);
});

test("play() rejects with the error name of media elements if it cannot start", async () => {
  const fake = new FakePlayer({ groups: 3 });
  const promises = new PlayPromises(fake.player, () => fake.player.play());
  await assert.rejects(promises.play(), { name: "NotSupportedError", message: /address is missing/ });
  const cases: [string, () => void][] = [
    ["AbortError", () => fake.player.pause()],
    ["AbortError", () => fake.player.close()],
    ["NotAllowedError", () => fake.player.emit("notallowed")],
  ];
  for (const [name, act] of cases) {
    await fake.open();
    const refused = assert.rejects(promises.play(), { name });
    act();
    await refused;
    fake.player.pause();
  }
  host.answer(status(404));
  const refused = assert.rejects((void fake.player.load("https://page.example/none.json"), promises.play()), {
    name: "NotSupportedError",
    message: /none\.json cannot be downloaded/,
  });
  await time.pass(0);
  await refused;
  await assert.rejects(promises.play(), { name: "NotSupportedError", message: /none\.json/ });
});
