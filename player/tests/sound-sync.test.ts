import assert from "node:assert/strict";
import { test } from "node:test";
import { SoundSync } from "../packages/renderer/src/sound/soundtrack";

/** Pictures at 60 a second that follow a sound whose time is told only so finely; how far they are from it, and their largest step back. */
function run(seconds: number, soundAt: (now: number) => number, rate = 1): { behind: number[]; pictures: number[] } {
  const follower = new SoundSync();
  const [behind, pictures] = [[] as number[], [0]];
  for (let now = 0; now < seconds; now += 1 / 60) {
    const shown = pictures.at(-1)!;
    pictures.push(shown + follower.follow(soundAt(now), shown, rate, now, 1 / 60));
    behind.push(soundAt(now) - pictures.at(-1)!);
  }
  return { behind, pictures };
}

const coarse =
  (step: number, rate = 1) =>
  (now: number): number =>
    Math.floor((rate * now) / step) * step;

test("images follow a coarse sound clock smoothly", () => {
  for (const rate of [0.5, 1, 2]) {
    const { pictures, behind } = run(4, coarse(0.04, rate), rate);
    const steps = pictures.slice(60).map((value, index) => value - pictures[59 + index]);
    assert.ok(Math.max(...behind.slice(60).map(Math.abs)) < 0.06);
    assert.ok(Math.min(...steps.slice(1)) > (0.8 * rate) / 60 && Math.max(...steps.slice(1)) < (1.2 * rate) / 60);
  }
});

test("images wait for the sound to begin, and never go back", () => {
  const late = run(2, (now) => Math.max(now - 0.5, 0) - 0.2);
  assert.equal(late.pictures[35], 0);
  assert.ok(Math.abs(late.behind.at(-1)!) < 0.01);
  assert.ok(late.pictures.every((value, index) => index === 0 || value >= late.pictures[index - 1]));
});

test("drift of the sound is compensated, a jump is followed", () => {
  assert.ok(Math.abs(run(6, (now) => 1.01 * now).behind.at(-1)!) < 0.01);
  assert.ok(Math.abs(run(3, (now) => now + (now > 2 ? 0.5 : 0)).behind.at(-1)!) < 0.01);
});

test("images wait for stalled sound for a while, then continue without it until it returns", () => {
  const follower = new SoundSync();
  let pictures = 0;
  const at = (now: number, sound: number): number => (pictures += follower.follow(sound, pictures, 1, now, 0.02));
  for (let now = 0; now < 1; now += 0.02) at(now, now);
  for (let now = 1; now < 4; now += 0.02) at(now, 1);
  assert.ok(pictures > 2.2 && pictures < 2.8);
  assert.equal(follower.recovered, false);
  at(4, 1.02);
  assert.equal(follower.recovered, true);
  follower.restart();
  assert.equal(follower.recovered, false);
});
