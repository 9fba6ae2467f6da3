import assert from "node:assert/strict";
import { test } from "node:test";
import { DeviceLostError, PLAIN, ReelError } from "../src/base/errors";
import { describe } from "../src/player/stats";
import { FakePlayer } from "./fakes/player";
import { status, whole } from "./fakes/host";
import { device, page } from "./fakes/page";
import { ADDRESS, documentOf, type Plan } from "./fakes/reel";
import { FakeWorker } from "./fakes/workers";

const { host, time } = FakePlayer;
const OFTEN = ["progress", "drawn", "timeupdate", "volumechange"];
const started = async (plan: Plan = { groups: 3 }): Promise<FakePlayer> => {
  const fake = new FakePlayer(plan);
  await fake.start();
  fake.heard();
  return fake;
};
const near = (value: number, expected: number, by = 0.05): void => assert.ok(Math.abs(value - expected) < by, `${value}, expected ${expected}`);

test("a reel opens: what rests shows first, then the whole picture", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  assert.deepEqual(fake.heard("progress", "volumechange"), ["loadstart", "loadedmetadata", "durationchange"]);
  assert.deepEqual([fake.player.duration, fake.player.canPlay, fake.player.busy, fake.player.playback.hasPicture], [3, false, true, false]);
  fake.files.give("layers/0.bin");
  await fake.pass(40);
  assert.deepEqual(fake.heard("progress"), ["loadeddata", "drawn"]);
  assert.deepEqual([fake.stage.points, fake.player.canPlay], [100, false]);
  fake.files.give("groups/0.bin");
  await fake.pass(40);
  assert.deepEqual(fake.heard("progress", "drawn"), ["canplay"]);
  assert.deepEqual([fake.player.canPlay, fake.player.waiting, fake.stage.points], [true, false, 200]);
  await fake.player.whenReady();
});

test("nothing is drawn while nothing changes", async () => {
  const fake = await started();
  await fake.pass(400);
  const { pictures } = fake.stage;
  await fake.pass(400);
  assert.equal(fake.stage.pictures, pictures);
  fake.player.invalidate();
  await fake.pass(40);
  assert.equal(fake.stage.pictures, pictures + 2, "at once, and as it is sorted then");
});

test("time runs while it plays, at its rate, and ends at the end", async () => {
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

test("a reel that goes round begins again without an end", async () => {
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

test("a tab that was in the background goes on where it was", async () => {
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

test("where data is missing time stands still, and goes on once it is here", async () => {
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

test("a seek is over once the picture of its time is there; until then the last one stays", async () => {
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
  assert.deepEqual([fake.heard(...OFTEN), fake.player.seeking, fake.stage.scene!.current], [["seeked"], false, { group: 15, frame: 5 }]);
  assert.throws(() => (fake.player.currentTime = NaN), TypeError);
  fake.player.step(-1);
  near(fake.player.currentTime, 15.4, 1e-9);
  fake.player.currentTime = 99;
  assert.equal(fake.player.currentTime, 20);
});

test("while it plays a seek waits for its picture, and time goes on from there", async () => {
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

test("what failed and rests is asked for again, also while nothing moves", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  fake.files.say("groups/1.bin", { error: "no" });
  await fake.pass(9000, 100);
  assert.ok(!fake.files.coming.includes("groups/1.bin"));
  await fake.pass(5000, 100);
  assert.ok(fake.files.coming.includes("groups/1.bin"));
});

test("each layer that comes before the first group shows at once", async () => {
  const fake = new FakePlayer({ groups: 2, layers: [0, 0] });
  await fake.open();
  for (const [uri, points] of [["layers/1.bin", 0], ["layers/0.bin", 200]] as const) {
    fake.files.give(uri);
    await fake.pass(40);
    assert.equal(fake.stage.points, points);
  }
  const other = new FakePlayer({ groups: 2, layers: [0, 0] });
  await other.open();
  for (const [uri, points] of [["layers/0.bin", 100], ["layers/1.bin", 200]] as const) {
    other.files.give(uri);
    await other.pass(40);
    assert.equal(other.stage.points, points);
  }
});

test("a group fades in over the one before it: both are sorted, and both are kept", async () => {
  const fake = await started();
  fake.player.currentTime = 1.1;
  await fake.pass(60);
  assert.deepEqual(fake.stage.scene, { layers: ["layers/0.bin"], current: { group: 1, frame: 1 }, previous: { group: 0, frame: 9 } });
  assert.deepEqual(fake.stage.inUse, [1, 0]);
  assert.equal(fake.stage.points, 300);
  fake.player.currentTime = 1.3;
  await fake.pass(60);
  assert.equal(fake.stage.scene!.previous, null);
});

test("time that is set before the reel is here is where it begins", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.load(ADDRESS);
  fake.player.currentTime = 2.5;
  assert.equal(fake.player.currentTime, 2.5);
  await time.pass(0);
  fake.files.give("layers/0.bin");
  assert.deepEqual([fake.player.currentTime, fake.files.coming], [2.5, ["groups/2.bin"]]);
});

test("a reel that cannot be had says why; trying again goes on where it was", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  fake.player.camera!.orbit(0.2, 0);
  const { viewmat } = fake.player.camera!;
  fake.files.say("groups/15.bin", { error: "groups/15.bin is damaged.", plain: PLAIN.damaged });
  assert.equal(fake.player.error, null, "the manifest is read again first");
  await time.pass(0);
  assert.deepEqual(fake.heard(...OFTEN), ["seeking", "error"]);
  assert.ok(fake.player.error instanceof ReelError && fake.player.error.plain === PLAIN.damaged);
  fake.files.give("groups/14.bin");
  fake.player.canvas.dispatchEvent(new Event("webglcontextlost"));
  assert.deepEqual(fake.heard(), [], "nothing is taken in any more, and one error is enough");
  fake.player.play();
  await fake.pass(200);
  assert.equal(fake.player.currentTime, 15, "nothing plays");
  page.dispatchEvent(new Event("online"));
  await time.pass(0);
  assert.deepEqual([fake.player.error, fake.player.currentTime], [null, 15]);
  assert.deepEqual(fake.player.camera!.viewmat.map((v) => v.toFixed(6)), viewmat.map((v) => v.toFixed(6)));
  assert.deepEqual(fake.files.coming, ["layers/0.bin"]);
  fake.files.give("layers/0.bin");
  assert.deepEqual(fake.files.coming, ["groups/15.bin", "groups/14.bin"]);
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("a reel that was replaced on its host is opened anew, at the same time and view", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  fake.player.camera!.orbit(0.2, 0);
  const { viewmat } = fake.player.camera!;
  for (const plain of [PLAIN.damaged, PLAIN.missing]) {
    host.answer(whole(JSON.stringify(documentOf({ groups: 20, points: plain === PLAIN.damaged ? 50 : 60 }))));
    fake.files.say("groups/15.bin", { error: "groups/15.bin is another one.", plain });
    await time.pass(0);
    assert.deepEqual([fake.player.error, fake.player.currentTime], [null, 15]);
    assert.deepEqual(fake.player.camera!.viewmat.map((v) => v.toFixed(6)), viewmat.map((v) => v.toFixed(6)));
    assert.deepEqual(fake.files.coming, ["layers/0.bin"]);
    fake.files.give("layers/0.bin");
  }
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("a manifest that does not come does not keep an error back for long", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  host.answer(() => new Response(new ReadableStream()));
  fake.files.say("groups/15.bin", { error: "groups/15.bin is damaged.", plain: PLAIN.damaged });
  await time.pass(9000);
  assert.equal((fake.player.error as ReelError).plain, PLAIN.damaged);
});

test("what was played is known, and only that", async () => {
  const fake = await started({ groups: 3 });
  const played = (): string => fake.player.played.ranges.map((range) => range.map((time) => time.toFixed(1)).join("-")).join();
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

test("a time that a page sets before there is a reel is where that begins", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.currentTime = "1.5" as unknown as number;
  assert.equal(fake.player.currentTime, 1.5);
  await fake.start();
  assert.equal(fake.player.currentTime, 1.5);
  await fake.start();
  assert.equal(fake.player.currentTime, 0, "of one reel only");
});

test("while pictures are deferred no more than the manifest is got", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.deferred = true;
  await fake.open();
  assert.deepEqual([fake.player.manifest !== null, fake.files.coming, fake.player.busy], [true, [], false]);
  fake.player.deferred = false;
  assert.deepEqual([fake.files.coming, fake.player.busy], [["layers/0.bin"], true]);
});

test("no manifest, none of ours, no graphics device: each says so", async () => {
  const fake = new FakePlayer();
  host.answer(status(404));
  await fake.open();
  assert.equal((fake.player.error as ReelError).plain, PLAIN.missing);
  host.answer(whole("{}"));
  fake.player.retry();
  await time.pass(0);
  assert.equal((fake.player.error as ReelError).plain, PLAIN.other);
  await assert.rejects(fake.player.whenReady(), { name: "ReelError" });
  const other = new FakePlayer();
  Object.assign(other.player.canvas, { getContext: () => null });
  await other.open();
  assert.equal((other.player.error as ReelError).plain, PLAIN.device);
});

test("a device that is lost is no fault of the reel, and it goes on when it is back", async () => {
  const fake = await started();
  fake.device.lost = true;
  fake.player.canvas.dispatchEvent(new Event("webglcontextlost"));
  assert.ok(fake.player.error instanceof DeviceLostError);
  fake.device.lost = false;
  fake.player.canvas.dispatchEvent(new Event("webglcontextrestored"));
  await time.pass(0);
  assert.equal(fake.player.error, null);
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("what fails because the device is lost is called by that", async () => {
  const fake = new FakePlayer();
  await fake.open();
  fake.device.lost = true;
  fake.files.say("layers/0.bin", { error: "no" });
  await time.pass(0);
  assert.ok(fake.player.error instanceof DeviceLostError);
});

test("what is closed in the middle of coming ends, and says nothing any more", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  fake.files.give("layers/0.bin");
  const workers = [...FakeWorker.all];
  fake.heard();
  fake.player.close();
  assert.ok(workers.every(({ terminated }) => terminated));
  assert.deepEqual([fake.heard(...OFTEN), fake.player.duration, fake.player.stats, fake.player.hasSource], [["emptied"], 0, null, false]);
  await fake.pass(20_000);
  assert.deepEqual(fake.heard(), []);
});

test("another reel takes the place of one that is still asked for, whatever becomes of that", async () => {
  for (const late of [JSON.stringify(documentOf({ groups: 2 })), "{}"]) {
    const fake = new FakePlayer({ groups: 3 });
    let answer: (text: string) => void = () => undefined;
    host.answer(() => new Response(new ReadableStream({ start: (controller) => void (answer = (text) => (controller.enqueue(new TextEncoder().encode(text)), controller.close())) })));
    void fake.player.load("https://page.example/first/manifest.json");
    await time.pass(0);
    host.answer(whole(JSON.stringify(documentOf({ groups: 7 }))));
    await fake.open();
    assert.equal(fake.player.duration, 7);
    answer(late);
    await time.pass(0);
    assert.deepEqual([fake.player.duration, fake.player.error], [7, null]);
  }
});

test("where nobody looks everything is given back, and it goes on from there without asking for the manifest", async () => {
  const fake = await started();
  fake.player.currentTime = 2.2;
  await fake.pass(60);
  const workers = [...FakeWorker.all];
  fake.player.rest();
  await time.pass(0);
  assert.ok(workers.every(({ terminated }) => terminated));
  assert.deepEqual([fake.player.session, fake.player.currentTime, fake.player.duration], [null, 2.2, 3]);
  host.answer(status(500));
  fake.heard();
  fake.player.wake();
  await time.pass(10);
  fake.files.giveAll();
  await fake.pass(60);
  assert.deepEqual([fake.player.canPlay, fake.player.currentTime, host.asked.length], [true, 2.2, 0]);
  assert.ok(!fake.heard().includes("loadedmetadata"));
});

test("a live reel without a group is waited for; then it begins at its edge, and grows until it is whole", async () => {
  const fake = new FakePlayer({ groups: 0, layers: [], live: true });
  await fake.open();
  assert.match(fake.player.notice!, /Waiting for the first group/);
  const answer = (plan: Plan): void => host.answer(whole(JSON.stringify(documentOf(plan))));
  answer({ groups: 2, live: true });
  await fake.pass(3000);
  assert.deepEqual([fake.player.notice, fake.player.live, fake.player.duration, fake.player.currentTime], [null, true, 2, 1]);
  fake.files.giveAll();
  await fake.pass(60);
  fake.player.play();
  await fake.pass(1500);
  assert.deepEqual([fake.player.currentTime, fake.player.paused, fake.player.ended], [2, false, false], "it waits at its edge");
  fake.heard();
  host.answer(status(500), status(500), status(500), whole(JSON.stringify(documentOf({ groups: 3, live: true, layers: [0, 2] }))));
  await fake.pass(12_000);
  assert.equal(fake.player.duration, 3);
  assert.ok(fake.heard().includes("durationchange"));
  assert.deepEqual(fake.files.coming.sort(), ["layers/1.bin"]);
  fake.files.giveAll();
  answer({ groups: 3, layers: [0, 2] });
  await fake.pass(6000);
  assert.deepEqual([fake.player.live, fake.player.ended], [false, true]);
  host.asked.length = 0;
  await fake.pass(10_000, 100);
  assert.equal(host.asked.length, 0, "what is whole does not grow");
});

test("a closed live reel is not asked for any more", async () => {
  const fake = new FakePlayer({ groups: 2, live: true });
  await fake.open();
  fake.player.close();
  await fake.pass(10_000, 100);
  assert.ok(host.asked.length <= 2, `${host.asked.length} requests`);
});

test("what a live reel was asked for when it was closed comes to nothing", async () => {
  const fake = new FakePlayer({ groups: 2, live: true });
  await fake.open();
  let answer = (): void => undefined;
  host.answer(() => new Response(new ReadableStream({ start: (controller) => void (answer = () => (controller.enqueue(new TextEncoder().encode(JSON.stringify(documentOf({ groups: 3, live: true })))), controller.close())) })));
  await fake.pass(3000, 100);
  assert.equal(host.asked.length, 1);
  fake.player.close();
  fake.heard();
  answer();
  await time.pass(10_000);
  assert.deepEqual([fake.heard(), fake.player.duration, host.asked.length], [[], 0, 1]);
});

test("a picture is taken of a time and a pose, and nothing else is drawn meanwhile", async () => {
  const fake = await started();
  const { camera } = fake.player.manifest!;
  const taken = fake.player.renderAt(1.5, camera, 32, 18);
  await fake.pass(200);
  const picture = await taken;
  assert.deepEqual([picture.width, picture.height, picture.data.length], [32, 18, 4 * 32 * 18]);
});

test("a rendition that people choose stays chosen, also for the next reel, where it has one of this name", async () => {
  const fake = await started({ groups: 3, renditions: ["high", "low"] });
  assert.deepEqual([fake.player.renditions, fake.player.rendition, fake.player.shownRendition], [["high", "low"], null, "high"]);
  fake.player.rendition = "low";
  await fake.open();
  fake.files.give("layers/0.bin");
  assert.deepEqual(fake.files.coming, ["groups/0.low.bin"]);
  fake.player.rendition = "none of these";
  await fake.open();
  fake.files.giveAll();
  assert.deepEqual([fake.player.rendition, fake.player.shownRendition], ["none of these", "high"]);
});

test("numbers on how it does", async () => {
  device.deviceMemory = 2;
  const fake = await started();
  const stats = fake.player.stats!;
  assert.deepEqual([stats.points, stats.bitrate, stats.rendition, stats.ahead, stats.width], [200, 8000, null, 3, 160]);
  assert.deepEqual(Object.fromEntries(describe({ ...stats, throughput: 2.5e6, decodeMilliseconds: 3.14, sortMilliseconds: 25 })), {
    Pictures: "60 fps, 160 × 90".replace("60", stats.fps.toFixed(0)), Points: "200", Bitrate: "0.0 Mbit/s", Network: "2.5 Mbit/s", Buffer: "3.0 s", Decode: "3.1 ms", Sort: "25 ms",
  });
});
