/** Opening a reel in a player, drawing it, and releasing it. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { describe } from "../packages/element/src/ui/statistics";
import { status, whole } from "./fakes/host";
import { device, page } from "./fakes/page";
import { FakePlayer, OFTEN, started } from "./fakes/player";
import { documentOf } from "./fakes/reel";
import { FakeWorker } from "./fakes/workers";

const { host, time } = FakePlayer;

test("an opened reel shows static points first, then the whole image", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  assert.deepEqual(fake.heard("progress", "volumechange"), ["loadstart", "loadedmetadata", "durationchange"]);
  assert.deepEqual(
    [fake.player.duration, fake.player.canPlay, fake.player.busy, fake.player.playback.hasPicture],
    [3, false, true, false],
  );
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

test("each layer that arrives before the first group is drawn at once", async () => {
  const fake = new FakePlayer({ groups: 2, layers: [0, 0] });
  await fake.open();
  for (const [uri, points] of [
    ["layers/1.bin", 0],
    ["layers/0.bin", 200],
  ] as const) {
    fake.files.give(uri);
    await fake.pass(40);
    assert.equal(fake.stage.points, points);
  }
  const other = new FakePlayer({ groups: 2, layers: [0, 0] });
  await other.open();
  for (const [uri, points] of [
    ["layers/0.bin", 100],
    ["layers/1.bin", 200],
  ] as const) {
    other.files.give(uri);
    await other.pass(40);
    assert.equal(other.stage.points, points);
  }
});

test("a layer is drawn while the rest of its group never arrives, and playback waits for all of it", async () => {
  const fake = new FakePlayer({ groups: 2, layers: [0, 0], layerBytes: 100_000 });
  await fake.open();
  fake.files.give("layers/0.bin");
  await fake.pass(40);
  assert.deepEqual(fake.heard("progress", "volumechange", "loadstart", "loadedmetadata", "durationchange"), [
    "loadeddata",
    "drawn",
  ]);
  fake.player.play();
  await fake.pass(5000);
  const { canPlay, busy, waiting, currentTime } = fake.player;
  assert.deepEqual([fake.stage.points, fake.files.coming], [100, ["layers/1.bin"]]);
  assert.deepEqual([canPlay, busy, waiting, currentTime], [false, true, true, 0]);
  fake.files.give("layers/1.bin", "groups/0.bin");
  await fake.pass(40);
  assert.deepEqual([fake.player.canPlay, fake.stage.points], [true, 300]);
});

test("in a cross-fade both groups are sorted, and both are kept", async () => {
  const fake = await started();
  fake.player.currentTime = 1.1;
  await fake.pass(60);
  assert.deepEqual(fake.stage.scene, {
    layers: ["layers/0.bin"],
    current: { group: 1, frame: 1 },
    previous: { group: 0, frame: 9 },
  });
  assert.deepEqual(fake.stage.inUse, [1, 0]);
  assert.equal(fake.stage.points, 300);
  fake.player.currentTime = 1.3;
  await fake.pass(60);
  assert.equal(fake.stage.scene!.previous, null);
});

test("only the manifest is loaded while images are deferred", async () => {
  const fake = new FakePlayer({ groups: 3 });
  fake.player.deferred = true;
  await fake.open();
  assert.deepEqual([fake.player.manifest !== null, fake.files.coming, fake.player.busy], [true, [], false]);
  fake.player.deferred = false;
  assert.deepEqual([fake.files.coming, fake.player.busy], [["layers/0.bin"], true]);
});

test("a reel that is closed while loading ends without further events", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  fake.files.give("layers/0.bin");
  const workers = [...FakeWorker.all];
  fake.heard();
  fake.player.close();
  assert.ok(workers.every(({ terminated }) => terminated));
  assert.deepEqual(
    [fake.heard(...OFTEN), fake.player.duration, fake.player.stats, fake.player.hasSource],
    [["emptied"], 0, null, false],
  );
  await fake.pass(20_000);
  assert.deepEqual(fake.heard(), []);
});

test("another reel replaces one that is still loading, whatever its result", async () => {
  for (const late of [JSON.stringify(documentOf({ groups: 2 })), "{}"]) {
    const fake = new FakePlayer({ groups: 3 });
    let answer: (text: string) => void = () => undefined;
    host.answer(
      () =>
        new Response(
          new ReadableStream({
            start: (controller) =>
              void (answer = (text) => (controller.enqueue(new TextEncoder().encode(text)), controller.close())),
          }),
        ),
    );
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

test("a hidden player releases everything, and continues without loading the manifest again", async () => {
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

test("an image is rendered at a time and a pose, and nothing else is drawn meanwhile", async () => {
  const fake = await started();
  const { camera } = fake.player.manifest!;
  const taken = fake.player.renderAt(1.5, camera, 32, 18);
  await fake.pass(200);
  const picture = await taken;
  assert.deepEqual([picture.width, picture.height, picture.data.length], [32, 18, 4 * 32 * 18]);
});

test("a chosen rendition stays chosen, also for the next reel that has one of this name", async () => {
  const fake = await started({ groups: 3, renditions: ["high", "low"] });
  assert.deepEqual(
    [fake.player.renditions, fake.player.rendition, fake.player.shownRendition],
    [["high", "low"], null, "high"],
  );
  fake.player.rendition = "low";
  await fake.open();
  fake.files.give("layers/0.bin");
  assert.deepEqual(fake.files.coming, ["groups/0.low.bin"]);
  fake.player.rendition = "none of these";
  await fake.open();
  fake.files.giveAll();
  assert.deepEqual([fake.player.rendition, fake.player.shownRendition], ["none of these", "high"]);
});

test("statistics describe what the player does", async () => {
  device.deviceMemory = 2;
  const fake = await started();
  const stats = fake.player.stats!;
  assert.deepEqual([stats.points, stats.bitrate, stats.rendition, stats.ahead, stats.width], [200, 8000, null, 3, 160]);
  assert.deepEqual(
    Object.fromEntries(describe({ ...stats, throughput: 2.5e6, decodeMilliseconds: 3.14, sortMilliseconds: 25 })),
    {
      Pictures: "60 fps, 160 × 90".replace("60", stats.fps.toFixed(0)),
      Points: "200",
      Bitrate: "0.0 Mbit/s",
      Network: "2.5 Mbit/s",
      Buffer: "3.0 s",
      Decode: "3.1 ms",
      Sort: "25 ms",
    },
  );
});
