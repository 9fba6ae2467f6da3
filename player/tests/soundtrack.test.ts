import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { afterEach, beforeEach, mock, test } from "node:test";
import type { Sound } from "../packages/decoder/src/reel/presentation";
import { SoundSync, Soundtrack } from "../packages/renderer/src/sound/soundtrack";
import { FakeAudio, FakeMediaSource } from "./fakes/audio";
import { type Answer, FakeHost, status } from "./fakes/host";
import { Reel } from "../packages/decoder/src/reel/reel";
import { manifestOf } from "./fakes/reel";
import { FakeTime } from "./fakes/time";

const time = new FakeTime();
const host = new FakeHost();
mock.method(console, "warn", () => undefined);
// Digests without another thread, so that they come at once.
const digest = async (_: string, bytes: Uint8Array): Promise<Uint8Array> => createHash("sha256").update(bytes).digest();
Object.defineProperty(globalThis, "crypto", { value: { subtle: { digest } } });

const digestOf = (...bytes: number[]): string => createHash("sha256").update(Uint8Array.from(bytes)).digest("hex");
/** Segments of two seconds whose bytes are their start and length. */
const segments = [...Array(60).keys()].map((index) => ({
  uri: `sound/${index}.m4s`,
  bytes: 2,
  sha256: digestOf(2 * index, 2),
  start: 2 * index,
  seconds: 2,
}));
const answers: Answer = (_, url) => {
  const index = /(\d+)\.m4s$/.exec(url)?.[1];
  return new Response(index === undefined ? new Uint8Array(1) : Uint8Array.of(2 * Number(index), 2));
};
const asked = (): string[] => host.asked.map(({ url }) => url.replace("https://page.example/reel/sound/", ""));

let events: string[] = [];
let track: Soundtrack;
let reel: Reel;
const clock = { seconds: 0, rate: 1, loop: false, live: false, earliest: 0 };
const soundOf = (more: Partial<Sound> = {}): Sound => ({
  type: 'audio/mp4; codecs="opus"',
  rate: 48000,
  channels: 2,
  init: { uri: "sound/init.mp4", bytes: 1, sha256: digestOf(0) },
  segments,
  position: null,
  ...more,
});
const openReel = (sound: Sound | null = soundOf(), live = false): void => {
  const manifest = manifestOf({ live });
  reel = new Reel({ ...manifest, presentation: { ...manifest.presentation, sound } });
  track.open(reel);
};
/** Have sound from now on, and the browser ready to take it. */
const begin = async (pictures = true): Promise<void> => {
  track.want(clock, pictures);
  FakeMediaSource.last.open();
  await time.pass(0);
  await time.pass(0);
};
const pass = (passed: number): number => track.advance(clock, true, time.now / 1000, passed, 0);

afterEach(() => track.close());

beforeEach(() => {
  Object.assign(clock, { seconds: 0, rate: 1, loop: false, live: false, earliest: 0 });
  Object.assign(globalThis, { MediaSource: FakeMediaSource });
  FakeAudio.plays = "";
  events = [];
  track = new Soundtrack(
    (event) => events.push(event),
    () => events.push("stop"),
  );
  host.answer(answers);
});

test("a reel without sound follows the wall clock", () => {
  openReel(null);
  assert.deepEqual([track.available, track.isLate(clock), pass(0.02)], [false, false, 0.02]);
  track.want(clock, true);
  assert.deepEqual(asked(), []);
});

test("sound is downloaded only if it is audible, in playing order, ten seconds ahead", async () => {
  openReel();
  assert.deepEqual([track.available, track.placed, asked()], [true, false, []]);
  await begin();
  assert.deepEqual(asked(), ["init.mp4", "0.m4s", "1.m4s", "2.m4s", "3.m4s", "4.m4s"]);
});

test("before the first image only the current segment is requested", async () => {
  openReel();
  clock.seconds = 7;
  await begin(false);
  assert.deepEqual(asked(), ["init.mp4", "3.m4s"]);
});

test("images wait for late sound and its first moment, then follow it", async () => {
  openReel();
  track.want(clock, true);
  assert.deepEqual([track.isLate(clock), pass(0.02)], [true, 0]);
  await begin();
  assert.equal(track.isLate(clock), false);
  assert.equal(pass(0.02), 0, "it starts");
  const audio = FakeAudio.last;
  assert.deepEqual([audio.paused, audio.currentTime], [false, 0]);
  for (let i = 1; i <= 100; i++) {
    time.now += 20;
    audio.currentTime = (0.9 * time.now) / 1000 - (0.9 * (time.now - 20 * i)) / 1000; // a sound card that is slow
    clock.seconds += pass(0.02);
  }
  assert.ok(Math.abs(clock.seconds - audio.currentTime) < 0.03, `${clock.seconds} and ${audio.currentTime}`);
});

test("sound follows the playback rate; rates too slow for browsers are silent", async () => {
  openReel();
  clock.rate = 2;
  await begin();
  pass(0.02);
  assert.equal(FakeAudio.last.playbackRate, 2);
  clock.rate = 0.05;
  assert.deepEqual([track.isLate(clock), pass(0.02), FakeAudio.last.paused], [false, 0.02, true]);
});

test("after a seek the sound is in step with the images, and its segment is requested first", async () => {
  openReel();
  await begin();
  pass(0.02);
  host.answer((options, url) => {
    if (url.endsWith("/20.m4s")) track.want({ ...clock, seconds: 80 }, true); // once more, while it comes
    return answers(options, url);
  });
  clock.seconds = 40.5;
  track.seek();
  track.want(clock, true);
  await time.pass(0);
  assert.deepEqual(asked().slice(0, 2), ["20.m4s", "40.m4s"], "what nobody waits for any more is given up");
  clock.seconds = 80.5;
  assert.equal(track.isLate(clock), false);
  track.seek();
  pass(0.02);
  assert.equal(FakeAudio.last.currentTime, 80.5);
  clock.seconds = 80.55;
  track.seek();
  pass(0.02);
  assert.equal(FakeAudio.last.currentTime, 80.55, "also where it is not far");
});

test("old sound segments are released", async () => {
  openReel();
  await begin();
  for (clock.seconds = 0; clock.seconds < 118; clock.seconds += 2) {
    track.want(clock, true);
    await time.pass(0);
  }
  const held = FakeMediaSource.last.buffer.ranges.map(([start]) => start);
  assert.ok(held.length < 60 && !held.includes(0) && held.includes(100), String(held));
});

test("images continue where the sound has gaps and after its end", async () => {
  openReel(soundOf({ segments: [segments[0], segments[3]] }));
  await begin();
  for (const seconds of [3, 7.95, 50]) {
    clock.seconds = seconds;
    assert.deepEqual([track.isLate(clock), pass(0.02)], [false, 0.02], `at ${seconds} s`);
  }
});

test("a paused reel is silent", async () => {
  openReel();
  await begin();
  pass(0.02);
  assert.equal(FakeAudio.last.paused, false);
  assert.equal(track.advance(clock, false, 0, 0.02, 0), 0);
  assert.equal(FakeAudio.last.paused, true);
  pass(0.02);
  document.dispatchEvent(new Event("visibilitychange"));
  assert.equal(FakeAudio.last.paused, true);
});

test("if the browser blocks sound, a user's play() stops and autoplay becomes silent", async () => {
  for (const [optional, expected] of [
    [false, ["notallowed", "stop"]],
    [true, ["volumechange", "volumechange"]],
  ] as const) {
    track = new Soundtrack(
      (event) => events.push(event),
      () => events.push("stop"),
    );
    openReel();
    await begin();
    FakeAudio.last.refuses = "NotAllowedError";
    events = [];
    track.ask(optional);
    await time.pass(0);
    assert.deepEqual([events, track.muted, track.blocked], [expected, optional, optional]);
  }
  FakeAudio.last.refuses = "AbortError";
  track.muted = false;
  assert.equal(track.blocked, false);
  events = [];
  track.ask(false);
  await time.pass(0);
  assert.deepEqual(events, [], "it was paused meanwhile");
});

test("volume and mute reach the sound", async () => {
  openReel();
  await begin();
  pass(0.02);
  const audio = FakeAudio.last;
  events = [];
  track.volume = 0.5;
  assert.deepEqual([track.volume, audio.volume, events], [0.5, 0.5, ["volumechange"]]);
  track.volume = 0.5;
  track.muted = false;
  assert.deepEqual(events, ["volumechange"], "nothing changed");
  for (const wrong of [-0.1, 1.1, NaN]) assert.throws(() => (track.volume = wrong), { name: "IndexSizeError" });
  track.toggle();
  assert.deepEqual([track.muted, audio.paused, pass(0.02)], [true, true, 0.02]);
  track.toggle();
  assert.deepEqual([track.muted, track.volume], [false, 0.5]);
  track.volume = 0;
  track.toggle();
  assert.deepEqual([track.muted, track.volume], [false, 1], "what was turned down to nothing comes back loud");
});

test("a failed segment ends the sound, and images continue", async () => {
  const cases: [RegExp, number[], Answer?][] = [
    [/0\.m4s cannot be downloaded/, [0, 2], status(404)],
    [/0\.m4s does not hold the sound from 0 s on/, [9, 9]],
    [/The sound is damaged/, [0, 2, 0]],
  ];
  for (const [message, bytes, bad = (): Response => new Response(Uint8Array.from(bytes))] of cases) {
    track = new Soundtrack(
      (event) => events.push(event),
      () => events.push("stop"),
    );
    openReel(soundOf({ segments: [{ ...segments[0], bytes: bytes.length, sha256: digestOf(...bytes) }] }));
    host.answer((options, url) => (url.endsWith("init.mp4") ? answers(options, url) : bad(options, url)));
    events = [];
    await begin();
    await time.pass(60_000);
    assert.deepEqual([track.available, pass(0.02)], [false, 0.02]);
    assert.match(track.error!.message, message);
    assert.deepEqual(events.at(-1), "volumechange");
    track.close();
    assert.equal(track.error, null);
  }
});

test("the reason of a delay is reported", async () => {
  openReel();
  host.answer(status(503));
  track.want(clock, true);
  await time.pass(100);
  assert.match(track.trouble!, /^Retrying/);
  assert.equal(events.at(-1), "progress");
  host.answer(answers);
  await time.pass(1000);
  assert.equal(track.trouble, null);
});

test("a browser without media sources plays the sound as one file once it is complete", async () => {
  Object.assign(globalThis, { MediaSource: undefined });
  FakeAudio.plays = "probably";
  openReel(soundOf({ segments: segments.slice(0, 3) }));
  track.want(clock, true);
  FakeAudio.last.currentTime = 0.95;
  assert.equal(track.isLate(clock), true);
  await time.pass(0);
  await time.pass(0);
  assert.deepEqual(asked(), ["init.mp4", "0.m4s", "1.m4s", "2.m4s"]);
  assert.deepEqual([track.isLate(clock), FakeAudio.last.src], [false, "blob:sound"]);
  clock.seconds = 1;
  pass(0.02);
  assert.equal(FakeAudio.last.currentTime, 1, "the element begins anew: its time is set");
  track.close();
  assert.equal(FakeAudio.last.src, "");
});

test("unsupported sound is dropped with a reason", () => {
  Object.assign(globalThis, { MediaSource: undefined });
  for (const [live, message] of [
    [false, /does not play sound of the type audio\/mp4; codecs="opus"/],
    [true, /only once the reel is complete/],
  ] as const) {
    track = new Soundtrack(
      (event) => events.push(event),
      () => undefined,
    );
    openReel(soundOf(), live);
    track.want(clock, true);
    assert.deepEqual([track.available, track.isLate(clock)], [false, false]);
    assert.match(track.error!.message, message);
  }
});

test("a segment dropped by a live reel does not end its sound; a permanently missing one does", async () => {
  openReel(soundOf(), true);
  Object.assign(clock, { seconds: 20, live: true });
  host.answer((options, url) => (/\/(10|11)\.m4s$/.test(url) ? status(404)(options, url) : answers(options, url)));
  await begin();
  assert.deepEqual([asked(), track.available], [["init.mp4", "10.m4s"], true]);
  const later = soundOf({ segments: segments.slice(11) });
  const manifest = manifestOf({ live: true });
  reel.grow({ ...manifest, presentation: { ...manifest.presentation, sound: later } });
  track.refresh();
  clock.seconds = 24;
  track.want(clock, true);
  await time.pass(4100);
  assert.deepEqual([asked().slice(2), track.available], [["12.m4s", "13.m4s", "14.m4s", "15.m4s", "16.m4s"], true]);
  clock.seconds = 22;
  track.want(clock, true);
  await time.pass(100);
  assert.equal(track.available, true, "it may have been dropped");
  track.want(clock, true);
  await time.pass(4100);
  await time.pass(0);
  assert.equal(asked().filter((name) => name === "11.m4s").length, 2);
  assert.match(track.error!.message, /11\.m4s cannot be downloaded: it answered 404/);
});

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
