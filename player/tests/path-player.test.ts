import assert from "node:assert/strict";
import { test } from "node:test";
import { eyeOf } from "../packages/decoder/src/base/matrix";
import { CameraPath, type Keyframe } from "../packages/element/src/camera/camera-path";
import { PathPlayer } from "../packages/element/src/player/path-player";
import { FakePlayer } from "./fakes/player";

const at = (x: number): number[] => [1, 0, 0, -x, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1];
const key = (seconds: number, x: number, time: number): Keyframe => ({ at: seconds, time, viewmat: at(x) });

/** A reel of five seconds, ready to play, and a path from 0 to 1 that takes `seconds` for its time from `from` to `to`. */
async function pathOf(
  seconds: number,
  from: number,
  to: number,
  loop = false,
): Promise<{ fake: FakePlayer; rider: PathPlayer; x: () => number; over: () => boolean }> {
  const fake = new FakePlayer({ groups: 5 });
  const rider = new PathPlayer(fake.player);
  await fake.start();
  rider.path = new CameraPath([key(0, 0, from), key(seconds, 1, to)], loop);
  let over = false;
  fake.heard();
  void rider.play().then(() => (over = true));
  return { fake, rider, x: () => eyeOf(fake.player.camera!.viewmat)[0], over: () => over };
}
const near = (value: number, expected: number, by = 0.06): void =>
  assert.ok(Math.abs(value - expected) < by, `${value}, expected ${expected}`);

test("playing needs a path and a reel", async () => {
  const fake = new FakePlayer();
  const rider = new PathPlayer(fake.player);
  await assert.rejects(rider.play(), { name: "ReelError", message: /no camera path/ });
  rider.path = new CameraPath([key(0, 0, 0), key(1, 1, 1)], false);
  await assert.rejects(rider.play(), { name: "ReelError", message: /no reel yet/ });
});

test("camera and reel play the path to its end, and the earlier state returns", async () => {
  const { fake, rider, x, over } = await pathOf(2, 1, 3);
  rider.stop();
  fake.player.loop = true;
  fake.player.playbackRate = 1.5;
  const done = rider.play();
  assert.deepEqual([fake.player.currentTime, rider.playing, fake.player.loop], [1, true, false]);
  await fake.pass(1000);
  near(fake.player.currentTime, 2);
  near(x(), 0.5, 0.1);
  assert.equal(fake.player.paused, false);
  await fake.pass(1200);
  await done;
  assert.deepEqual(
    [rider.playing, fake.player.paused, fake.player.loop, fake.player.playbackRate],
    [false, true, true, 1.5],
  );
  near(x(), 1, 1e-6);
  near(fake.player.currentTime, 3, 1e-6);
  assert.equal(over(), true, "the play that was stopped is over as well");
});

test("the reel plays at the path's pace", async () => {
  const { fake } = await pathOf(2, 0, 4);
  await fake.pass(1000);
  near(fake.player.playbackRate, 2, 0.2);
  near(fake.player.currentTime, 2, 0.1);
});

test("at a pace that cannot be played, the reel is shown frame by frame", async () => {
  for (const [seconds, from, to] of [
    [2, 1, 1],
    [4, 4, 0],
    [1, 0, 4.9],
  ]) {
    const { fake, x, rider } = await pathOf(seconds, from, to);
    await fake.pass(500);
    const part = x();
    assert.equal(fake.player.paused, true);
    near(fake.player.currentTime, from + (to - from) * (0.5 / seconds), 0.15);
    assert.ok(part > 0 && part < 1, String(part));
    await fake.pass(1000 * seconds);
    assert.equal(rider.playing, false);
    near(fake.player.currentTime, to, 1e-6);
  }
});

test("input on the reel or the camera stops the path in place", async () => {
  const hands: [string, (fake: FakePlayer) => void][] = [
    ["pauses", (fake) => fake.player.pause()],
    ["seeks", (fake) => void (fake.player.currentTime = 4)],
    ["turns", (fake) => fake.player.camera!.orbit(0.1, 0)],
    ["closes", (fake) => fake.player.close()],
  ];
  for (const [what, act] of hands) {
    const { fake, rider, over } = await pathOf(4, 0, 4);
    await fake.pass(500);
    assert.equal(rider.playing, true, what);
    act(fake);
    await fake.pass(60);
    assert.deepEqual([rider.playing, over()], [false, true], what);
    assert.equal(fake.player.paused, true, what);
  }
});

test("the camera waits with the reel for missing data", async () => {
  const fake = new FakePlayer({ groups: 5 });
  const rider = new PathPlayer(fake.player);
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  await fake.pass(60);
  rider.path = new CameraPath([key(0, 0, 0), key(4, 1, 4)], false);
  void rider.play();
  await fake.pass(2000);
  const x = (): number => eyeOf(fake.player.camera!.viewmat)[0];
  near(fake.player.currentTime, 1, 0.1);
  const waiting = x();
  await fake.pass(1000);
  assert.equal(x(), waiting);
  assert.equal(rider.playing, true);
  fake.files.giveAll();
  await fake.pass(1000);
  near(fake.player.currentTime, 2, 0.15);
  assert.ok(x() > waiting);
});

test("a moving camera waits for the image of each time, too", async () => {
  const fake = new FakePlayer({ groups: 5 });
  const rider = new PathPlayer(fake.player);
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  await fake.pass(60);
  rider.path = new CameraPath([key(0, 0, 0), key(10, 1, 2)], false);
  void rider.play();
  await fake.pass(8000);
  near(fake.player.camera!.following!.at, 5);
});

test("the camera keeps in step with a reel whose sound is slow", async () => {
  const { fake } = await pathOf(4, 0, 4);
  fake.player.soundtrack.advance = (_, running, __, passed) => (running ? 0.9 * passed : 0);
  await fake.pass(1000);
  near(fake.player.currentTime, 0.9, 0.03);
  near(fake.player.camera!.following!.at, fake.player.currentTime, 0.03);
});

test("a looping path continues", async () => {
  const { fake, rider } = await pathOf(1, 0, 1, true);
  await fake.pass(2500);
  assert.equal(rider.playing, true);
  near(fake.player.currentTime, 0.5, 0.2);
  rider.path = null;
  assert.deepEqual([rider.playing, rider.path], [false, null]);
});
