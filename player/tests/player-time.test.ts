/** Time in a player: playback, waiting for data, seeking. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { FakePlayer, OFTEN, started } from "./fakes/player";
import { ADDRESS } from "./fakes/reel";

const { time } = FakePlayer;
const near = (value: number, expected: number, by = 0.05): void =>
  assert.ok(Math.abs(value - expected) < by, `${value}, expected ${expected}`);

test("time advances during playback, at the playback rate, and stops at the end", async () => {
  const fake = await started();
  fake.player.play();
  await fake.pass(1000);
  near(fake.player.currentTime, 1);
  assert.deepEqual(fake.heard(...OFTEN), ["play", "playing"]);
  fake.player.playbackRate = 2;
  await fake.pass(500);
  near(fake.player.currentTime, 2, 0.1);
  await fake.pass(1000);
  assert.deepEqual([fake.player.currentTime, fake.player.paused, fake.player.ended], [3, true, true]);
  assert.deepEqual(fake.heard(...OFTEN), ["ratechange", "pause", "ended"]);
  fake.player.play();
  assert.equal(fake.player.currentTime, 0, "what has ended plays from the beginning");
});

test("a looping reel repeats without an ended event", async () => {
  const fake = await started();
  let sought = 0;
  fake.player.soundtrack.seek = () => void sought++;
  fake.player.loop = true;
  fake.player.play();
  await fake.pass(4500);
  assert.equal(sought, 1, "sound goes there, too");
  near(fake.player.currentTime, 1.5, 0.1);
  assert.deepEqual(fake.heard(...OFTEN), ["play", "playing"]);
});

test("a tab that was in the background continues at the same time", async () => {
  const fake = await started();
  fake.player.play();
  await fake.pass(200);
  const before = fake.player.currentTime;
  time.now += 60_000;
  await fake.pass(20);
  assert.ok(fake.player.currentTime - before <= 0.27, String(fake.player.currentTime));
  fake.player.show(false);
  await fake.pass(1000);
  assert.ok(fake.player.currentTime - before <= 0.27, "nobody looks");
});

test("time stops while data is missing, and continues once it arrives", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  await fake.pass(60);
  fake.player.play();
  fake.heard();
  await fake.pass(1500);
  near(fake.player.currentTime, 1);
  assert.deepEqual([fake.player.waiting, fake.player.busy], [true, true]);
  assert.deepEqual(fake.heard(...OFTEN), ["playing", "waiting"]);
  assert.equal(fake.player.ahead, 0);
  fake.files.giveAll();
  await fake.pass(500);
  near(fake.player.currentTime, 1.5, 0.1);
  assert.deepEqual(fake.heard(...OFTEN), ["playing"]);
  near(fake.player.ahead, 1.5, 0.1);
});

test("a seek ends once the image of its time is drawn; until then the last one stays", async () => {
  const fake = new FakePlayer({ groups: 20 });
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  await fake.pass(60);
  fake.heard();
  fake.player.currentTime = 15.5;
  assert.deepEqual([fake.player.currentTime, fake.player.seeking], [15.5, true]);
  await fake.pass(200);
  assert.deepEqual(fake.heard(...OFTEN), ["seeking"]);
  assert.equal(fake.stage.scene!.current!.group, 0);
  fake.files.confirm();
  fake.files.give("groups/15.bin");
  await fake.pass(40);
  assert.deepEqual(
    [fake.heard(...OFTEN), fake.player.seeking, fake.stage.scene!.current],
    [["seeked"], false, { group: 15, frame: 5 }],
  );
  assert.throws(() => (fake.player.currentTime = NaN), TypeError);
  fake.player.step(-1);
  near(fake.player.currentTime, 15.4, 1e-9);
  fake.player.currentTime = 99;
  assert.equal(fake.player.currentTime, 20);
});

test("a seek during playback waits for its image, then continues", async () => {
  const fake = new FakePlayer({ groups: 20 });
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  await fake.pass(60);
  fake.player.play();
  fake.player.currentTime = 0.5;
  assert.equal(fake.player.seeking, true);
  await fake.pass(20);
  assert.equal(fake.player.currentTime, 0.5, "its picture is sorted first");
  fake.player.currentTime = 15.5;
  await fake.pass(500);
  assert.equal(fake.player.currentTime, 15.5);
  fake.files.confirm();
  fake.files.give("groups/15.bin");
  await fake.pass(220);
  near(fake.player.currentTime, 15.7);
});

test("a time set before the reel is loaded is its start", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.load(ADDRESS);
  fake.player.currentTime = 2.5;
  assert.equal(fake.player.currentTime, 2.5);
  await time.pass(0);
  fake.files.give("layers/0.bin");
  assert.deepEqual([fake.player.currentTime, fake.files.coming], [2.5, ["groups/2.bin"]]);
});

test("`played` contains the played ranges only", async () => {
  const fake = await started({ groups: 3 });
  const played = (): string =>
    fake.player.played.ranges.map((range) => range.map((time) => time.toFixed(1)).join("-")).join();
  assert.equal(played(), "");
  fake.player.play();
  await fake.pass(400);
  fake.player.pause();
  assert.match(played(), /^0.0-0.[34]$/);
  fake.player.currentTime = 2;
  fake.files.giveAll();
  await fake.pass(60);
  fake.player.play();
  await fake.pass(200);
  assert.match(played(), /^0.0-0.[34],2.0-2.[12]$/);
  fake.player.currentTime = 0.2;
  await fake.pass(400);
  assert.match(played(), /^0.0-0.[56],2.0-2.[12]$/);
  fake.player.close();
  assert.equal(played(), "");
});

test("a time set before there is a source is the start of the next reel", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.currentTime = "1.5" as unknown as number;
  assert.equal(fake.player.currentTime, 1.5);
  await fake.start();
  assert.equal(fake.player.currentTime, 1.5);
  await fake.start();
  assert.equal(fake.player.currentTime, 0, "of one reel only");
});
