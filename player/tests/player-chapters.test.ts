/** A player and reels of version 2: pages that come when they are needed, chapters, and live reels that drop their beginning. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { PLAIN } from "../packages/decoder/src/base/errors";
import { whole } from "./fakes/host";
import { FakePlayer } from "./fakes/player";
import { documentOf, type Plan } from "./fakes/reel";

const { host, time } = FakePlayer;
const near = (value: number, expected: number): void =>
  assert.ok(Math.abs(value - expected) < 0.05, `${value}, expected ${expected}`);
const LONG: Plan = { groups: 200, page: 64, layers: [0, [0, 100], [100, 200]] };

test("a long reel opens with the groups in its manifest, and loads its first page first", async () => {
  const fake = new FakePlayer(LONG);
  await fake.open();
  assert.deepEqual(
    [fake.player.duration, fake.player.buffered, fake.player.waiting, fake.player.busy],
    [200, [], true, true],
  );
  assert.deepEqual(fake.files.coming, ["pages/0.json", "layers/0.bin"]);
  assert.deepEqual(fake.heard("progress", "volumechange"), ["loadstart", "loadedmetadata", "durationchange"]);
  fake.files.give("layers/0.bin");
  await fake.pass(40);
  assert.equal(fake.stage.points, 100, "what is never retired shows before the page is here");
  fake.files.giveAll();
  await fake.pass(60);
  assert.deepEqual([fake.player.canPlay, fake.stage.points, fake.player.buffered], [true, 300, [[0, 9]]]);
  assert.ok(!fake.heard().includes("durationchange"), "a page changes nothing that people see");
});

test("a seek into a missing page ends once its image is drawn", async () => {
  const fake = new FakePlayer(LONG);
  await fake.start();
  fake.heard();
  fake.player.currentTime = 110.5;
  assert.deepEqual([fake.player.seeking, fake.player.waiting, fake.player.progress], [true, true, 0]);
  await fake.pass(100);
  assert.deepEqual([fake.files.coming, fake.stage.scene!.current!.group], [["pages/64.json"], 0]);
  assert.equal(fake.player.stats!.bitrate, 0, "it is not known yet");
  fake.files.give("pages/64.json");
  assert.deepEqual(fake.files.coming, ["layers/2.bin"]);
  fake.files.giveAll();
  await fake.pass(100);
  assert.deepEqual(
    [fake.player.seeking, fake.stage.scene],
    [false, { layers: ["layers/0.bin", "layers/2.bin"], current: { group: 110, frame: 5 }, previous: null }],
  );
  assert.equal(fake.player.stats!.bitrate, 8000);
});

test("a cross-fade of chapters shows the layers of both, then those of the new one", async () => {
  const fake = new FakePlayer(LONG);
  await fake.start();
  fake.player.currentTime = 100.1;
  for (let i = 0; i < 6; i++) fake.files.giveAll();
  await fake.pass(100);
  assert.deepEqual(fake.stage.scene, {
    layers: ["layers/0.bin", "layers/1.bin", "layers/2.bin"],
    current: { group: 100, frame: 1 },
    previous: { group: 99, frame: 9 },
  });
  assert.equal(fake.stage.points, 500);
  fake.player.currentTime = 100.5;
  await fake.pass(100);
  assert.deepEqual([fake.stage.scene!.layers, fake.stage.points], [["layers/0.bin", "layers/2.bin"], 300]);
});

test("a reel plays across pages without a pause, and loops from its end", async () => {
  const fake = new FakePlayer({ groups: 24, page: 8, layers: [0, [8, 16]] });
  await fake.start();
  fake.player.loop = true;
  fake.player.play();
  fake.heard();
  for (let i = 0; i < 50; i++) {
    fake.files.giveAll();
    await fake.pass(500, 50);
  }
  near(fake.player.currentTime % 24, 25 - 24);
  assert.deepEqual(fake.heard("progress", "drawn", "timeupdate", "volumechange"), ["playing"]);
});

/** A live reel as it grows: its manifest is answered with from now on. */
const answer = (plan: Plan): void => host.answer(whole(JSON.stringify(documentOf(plan))));

test("a viewer before the window of a live reel moves to its beginning and continues", async () => {
  const plan: Plan = { groups: 20, live: true, first: 4, layers: [0, [0, 9], [9, 99]] };
  const fake = new FakePlayer(plan);
  await fake.start();
  near(fake.player.currentTime, 19);
  fake.player.currentTime = 0;
  assert.equal(fake.player.currentTime, 4, "it begins there");
  for (let i = 0; i < 4; i++) fake.files.giveAll();
  await fake.pass(100);
  fake.heard();
  answer({ ...plan, groups: 32, first: 16 });
  await fake.pass(3100, 100);
  assert.deepEqual(
    [fake.player.currentTime, fake.player.earliest, fake.player.duration, fake.player.seeking],
    [16, 16, 32, true],
  );
  assert.equal(fake.stage.scene!.current!.group, 4, "until it shows the last picture stays");
  fake.player.invalidate();
  await fake.pass(100);
  for (let i = 0; i < 4; i++) fake.files.giveAll();
  await fake.pass(200);
  assert.deepEqual(fake.heard("progress", "drawn", "timeupdate", "volumechange"), [
    "seeking",
    "durationchange",
    "seeked",
  ]);
  assert.deepEqual(
    [fake.player.error, fake.stage.scene!.current!.group, fake.stage.scene!.layers],
    [null, 16, ["layers/0.bin", "layers/2.bin"]],
  );
  assert.ok(!fake.player.stream!.held.includes(4));
});

test("a file before the window reloads the manifest instead of raising an error", async () => {
  const plan: Plan = { groups: 20, live: true, first: 4 };
  const fake = new FakePlayer(plan);
  await fake.start();
  fake.player.currentTime = 4.5;
  assert.deepEqual(fake.files.coming, ["groups/4.bin"]);
  answer({ ...plan, groups: 21, first: 6 });
  host.asked.length = 0;
  fake.files.say("groups/4.bin", { error: "it answered 404", plain: PLAIN.missing });
  await fake.pass(60);
  assert.deepEqual([host.asked.length, fake.player.error, fake.player.currentTime], [1, null, 6]);
  fake.files.giveAll();
  await fake.pass(100);
  assert.deepEqual([fake.player.seeking, fake.stage.scene!.current!.group], [false, 6]);
  // What the manifest still names has to be there.
  fake.player.currentTime = 17.5;
  fake.files.say("groups/17.bin", { error: "it answered 404", plain: PLAIN.missing });
  await fake.pass(60);
  assert.match(fake.player.error!.message, /answered 404/);
});

test("a manifest older than the known one changes nothing", async () => {
  const plan: Plan = { groups: 20, live: true, first: 4 };
  const fake = new FakePlayer(plan);
  await fake.start();
  answer({ ...plan, groups: 22, first: 8 });
  await fake.pass(3100, 100);
  answer({ ...plan, groups: 23, first: 3 });
  await fake.pass(3100, 100);
  assert.deepEqual([fake.player.earliest, fake.player.duration], [8, 22]);
  await time.pass(0);
});
