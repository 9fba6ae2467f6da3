import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { memoryBudget } from "../packages/decoder/src/stream/file-cache";
import { device } from "./fakes/page";
import { time, World } from "./fakes/stream";
import { LoadProgress } from "../packages/decoder/src/stream/stream";

beforeEach(() => {
  time.now += 1_000_000;
});

test("layers load first and alone, then the current group, then later groups, two at a time", () => {
  const world = new World({ groups: 5, layers: [0, 0, 2] });
  world.want({});
  assert.deepEqual(world.coming, ["layers/0.bin", "layers/1.bin"]);
  world.give("layers/0.bin");
  assert.deepEqual(world.coming, ["layers/1.bin"], "layers have the whole line");
  world.give("layers/1.bin");
  assert.deepEqual(world.coming, ["groups/0.bin"], "what shows has the whole line");
  assert.equal(world.stream.has(0), false);
  world.give("groups/0.bin");
  assert.equal(world.stream.has(0), true);
  assert.deepEqual(world.coming, ["groups/1.bin", "layers/2.bin"]);
  world.giveAll();
  assert.deepEqual(world.log, ["layer 0", "layer 1", "group 0", "group 1", "layer 2", "group 2", "group 3", "group 4"]);
  assert.equal(world.stream.busy, false);
});

test("large layers load one after the other, each requested while the end of the one before arrives", () => {
  const world = new World({ layers: [0, 0, 0], layerBytes: 100_000 });
  world.want({});
  assert.deepEqual(world.coming, ["layers/0.bin"]);
  time.now += 100;
  world.bytes("layers/0.bin", 1000);
  assert.deepEqual(world.coming, ["layers/0.bin"]);
  time.now += 100;
  world.bytes("layers/0.bin", 90_000);
  assert.deepEqual(world.coming, ["layers/0.bin", "layers/1.bin"]);
  world.give("layers/0.bin");
  assert.deepEqual([world.stream.loadedLayers, world.coming], [["layers/0.bin"], ["layers/1.bin"]]);
  world.give("layers/1.bin");
  assert.deepEqual(world.coming, ["layers/2.bin"]);
  world.give("layers/2.bin");
  assert.deepEqual(world.coming, ["groups/0.bin"]);
});

test("the current group is requested while the end of the last layer arrives", () => {
  const world = new World();
  world.want({});
  time.now += 100;
  world.bytes("layers/0.bin", 100);
  assert.deepEqual(world.coming, ["layers/0.bin"]);
  time.now += 100;
  world.bytes("layers/0.bin", 350);
  assert.deepEqual(world.coming, ["layers/0.bin", "groups/0.bin"]);
});

test("a group is loaded only with its layers", () => {
  const world = new World({ layers: [0, 1, 1] });
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.loadedLayers, ["layers/0.bin"]);
  const other = new World({ layers: [0, 1, 1] });
  other.want({});
  other.give("layers/0.bin", "groups/0.bin", "layers/2.bin", "groups/1.bin");
  assert.deepEqual([other.stream.has(0), other.stream.has(1)], [true, false]);
  other.want({ current: 1 });
  assert.deepEqual(other.stream.loadedLayers, ["layers/0.bin"], "as many as are complete from the first on");
  assert.deepEqual(other.stream.buffered, [[0, 1]]);
});

test("exactly eight seconds are loaded ahead", () => {
  const world = new World({ groups: 30 });
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.held, [...Array(9).keys()]);
  assert.deepEqual(world.stream.buffered, [[0, 9]]);
  world.want({ current: 1 });
  world.giveAll();
  assert.deepEqual(world.stream.held, [...Array(10).keys()]);
});

test("a seek cancels transfers for other times, and loads the new time first", () => {
  const world = new World({ groups: 40, layers: [0, 22, 25] });
  world.want({});
  world.give("layers/0.bin", "groups/0.bin");
  assert.deepEqual(world.coming, ["groups/1.bin", "groups/2.bin"]);
  world.want({ current: 25 });
  assert.deepEqual(world.givenUp, ["groups/1.bin", "groups/2.bin"]);
  assert.deepEqual(world.coming, []);
  world.confirm();
  assert.deepEqual(world.coming, ["layers/1.bin", "layers/2.bin"]);
  world.give("layers/2.bin", "layers/1.bin");
  assert.deepEqual(world.coming, ["groups/25.bin"]);
  world.give("groups/25.bin");
  assert.deepEqual(world.coming, ["groups/26.bin", "groups/27.bin"]);
});

test("a seek keeps a transfer that it needs, and cancels later ones", () => {
  const world = new World({ groups: 12 });
  world.want({});
  world.give("layers/0.bin", "groups/0.bin");
  world.want({ current: 2 });
  assert.deepEqual([world.givenUp, world.coming], [["groups/1.bin"], ["groups/2.bin"]]);
  world.confirm();
  assert.deepEqual(world.coming, ["groups/2.bin"]);
  world.give("groups/2.bin");
  world.want({ current: 6 });
  assert.deepEqual(world.coming, [], "what came is all behind");
  world.confirm();
  world.give("groups/6.bin");
  assert.deepEqual(world.coming, ["groups/7.bin", "groups/8.bin"]);
  world.want({ current: 5 });
  assert.deepEqual(world.givenUp.includes("groups/8.bin"), true, "the less urgent one makes way");
  world.confirm();
  assert.deepEqual(world.coming, ["groups/7.bin", "groups/5.bin"]);
});

test("a cross-fade needs both groups", () => {
  const world = new World({ groups: 12 });
  world.want({ current: 5, previous: 4, frame: 51 });
  world.give("layers/0.bin");
  assert.deepEqual(world.coming, ["groups/5.bin", "groups/4.bin"]);
  world.give("groups/5.bin");
  assert.deepEqual(world.coming, ["groups/4.bin"]);
});

test("the first group follows the last one only in a looping reel", () => {
  for (const [loop, next] of [
    [true, ["groups/0.bin", "groups/1.bin"]],
    [false, []],
  ] as const) {
    const world = new World({ groups: 5 });
    world.want({ current: 4, loop });
    world.give("layers/0.bin", "groups/4.bin");
    assert.deepEqual(world.coming, next);
  }
});

test("memory limits the buffer, and the least recently shown group is dropped first", () => {
  const world = new World({ groups: 20 }, 4);
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.held, [0, 1, 2, 3]);
  world.want({ current: 2 });
  world.giveAll();
  assert.deepEqual(world.stream.held, [2, 3, 4, 5]);
  assert.deepEqual(
    world.log.filter((line) => line.startsWith("dropped")),
    ["dropped 0", "dropped 1"],
  );
});

test("visible groups stay and the next group loads, however little memory there is", () => {
  const world = new World({ groups: 20 }, 1);
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.held, [0, 1]);
  world.want({ current: 10, inUse: [0] });
  world.giveAll();
  assert.deepEqual(world.stream.held.includes(0), true);
  world.want({ current: 10, inUse: [10] });
  world.giveAll();
  assert.deepEqual(world.stream.held, [10, 11]);
  world.want({ current: 19, inUse: [11] });
  world.giveAll();
  assert.deepEqual(world.stream.held, [11, 19]);
  world.want({ current: 19, inUse: [19] });
  assert.deepEqual(world.stream.held, [19], "what was on screen goes as soon as it is not");
});

test("a failed prefetch is not retried for ten seconds", () => {
  const world = new World({ groups: 4 });
  world.want({});
  world.give("layers/0.bin", "groups/0.bin");
  world.say("groups/1.bin", { error: "no" });
  assert.deepEqual(world.coming, ["groups/2.bin", "groups/3.bin"]);
  world.giveAll();
  time.now += 9_900;
  world.want({});
  assert.deepEqual(world.coming, []);
  time.now += 200;
  world.want({});
  assert.deepEqual(world.coming, ["groups/1.bin"]);
  world.say("groups/1.bin", { error: "no" });
  world.want({ current: 1 });
  assert.deepEqual(world.coming, ["groups/1.bin"], "what shows is asked for whether or not it failed before");
  assert.deepEqual(
    world.log.filter((line) => line.startsWith("failed")),
    [],
  );
});

test("the stream ends with one error if a visible file fails", async () => {
  for (const uri of ["layers/0.bin", "groups/0.bin"]) {
    const world = new World();
    world.want({});
    if (uri.startsWith("groups")) world.give("layers/0.bin");
    world.say(uri, { error: `${uri} is not there.` });
    world.want({ current: 3 });
    await Promise.resolve();
    assert.deepEqual(
      world.log.filter((line) => line.startsWith("failed")),
      [`failed ${uri} is not there.`],
    );
    assert.deepEqual(world.coming, []);
  }
});

test("a reel that was replaced is not a failure", async () => {
  const world = new World();
  world.want({});
  world.outdated = () => Promise.resolve(true);
  world.say("layers/0.bin", { error: "layers/0.bin is not there." });
  await Promise.resolve();
  assert.deepEqual([world.log, world.coming], [[], []]);
});

test("the reason of a delay is reported until bytes arrive again", () => {
  const world = new World();
  world.want({});
  world.say("layers/0.bin", { trouble: "Trying again." });
  assert.equal(world.stream.trouble, "Trying again.");
  world.bytes("layers/0.bin", 1);
  assert.equal(world.stream.trouble, null);
});

test("progress is the received share of the required bytes", () => {
  const world = new World();
  assert.equal(world.stream.progress, 0);
  world.want({});
  assert.equal(world.stream.progress, 0);
  world.bytes("layers/0.bin", 300);
  assert.equal(world.stream.progress, 300 / 1500);
  world.give("layers/0.bin");
  world.bytes("groups/0.bin", 700);
  assert.equal(world.stream.progress, 1200 / 1500);
  world.give("groups/0.bin");
  assert.equal(world.stream.progress, 1);
});

test("a fast network gets the best rendition, a slow one the lowest", () => {
  for (const [milliseconds, name] of [
    [1, ""],
    [100_000, ".low"],
  ] as const) {
    const world = new World({ renditions: ["high", "low"] });
    world.want({});
    time.now += milliseconds;
    world.bytes("layers/0.bin", 100);
    time.now += milliseconds;
    world.bytes("layers/0.bin", 400);
    world.give("layers/0.bin");
    assert.deepEqual(world.coming, [`groups/0${name}.bin`]);
    world.give(`groups/0${name}.bin`);
    assert.equal(world.stream.renditionOf(0), name ? "low" : "high");
    assert.equal(world.stream.fileOf(0).bytes, name ? 500 : 1000);
  }
});

test("a chosen rendition is shown from the next group on, even if others are loaded", () => {
  const world = new World({ groups: 3, renditions: ["high", "low"] });
  world.measure();
  world.giveAll();
  assert.deepEqual(
    [0, 1, 2].map((group) => world.stream.renditionOf(group)),
    ["high", "high", "high"],
  );
  world.log.length = 0;
  world.stream.choose("low");
  assert.deepEqual(world.coming, ["groups/1.low.bin", "groups/2.low.bin"]);
  world.giveAll();
  assert.deepEqual(
    [0, 1, 2].map((group) => world.stream.renditionOf(group)),
    ["high", "low", "low"],
  );
  assert.deepEqual(
    world.log,
    ["dropped 1", "group 1", "dropped 2", "group 2"],
    "what is here goes only once the other has come",
  );
});

test("another rendition of a visible group arrives too late", () => {
  const world = new World({ groups: 3, renditions: ["high", "low"] });
  world.measure();
  world.giveAll();
  world.stream.choose("low");
  world.want({ current: 1, inUse: [1] });
  assert.deepEqual(world.givenUp, ["groups/1.low.bin"]);
  assert.deepEqual(world.coming, ["groups/2.low.bin"]);
  world.confirm();
  world.giveAll();
  assert.deepEqual(
    [1, 2].map((group) => world.stream.renditionOf(group)),
    ["high", "low"],
  );
});

test("a needed group that arrives too slowly is loaded in the lowest rendition", () => {
  const world = new World({ renditions: ["high", "mid", "low"] });
  world.want({});
  time.now += 10;
  world.bytes("layers/0.bin", 1_000_000); // the line was fast
  world.give("layers/0.bin");
  assert.deepEqual(world.coming, ["groups/0.bin"]);
  time.now += 10;
  world.bytes("groups/0.bin", 10);
  time.now += 900;
  world.bytes("groups/0.bin", 10);
  assert.deepEqual(world.givenUp, [], "not in the first second");
  time.now += 200;
  world.bytes("groups/0.bin", 10);
  assert.deepEqual(world.givenUp, ["groups/0.bin"]);
  world.confirm();
  assert.deepEqual(world.coming, ["groups/0.low.bin"]);
  time.now += 9_000;
  world.bytes("groups/0.low.bin", 10);
  assert.deepEqual(world.givenUp, [], "there is nothing less");
  const two = new World({ renditions: ["high", "low"] });
  two.want({});
  two.give("layers/0.bin");
  two.bytes("groups/0.bin", 10);
  time.now += 1100;
  two.bytes("groups/0.bin", 10);
  assert.deepEqual(two.givenUp, [], "half of the bytes would not be here sooner by more than what is missing");
});

test("a chosen rendition is kept, however long it takes", () => {
  const world = new World({ renditions: ["high", "mid", "low"] });
  world.stream.choose("high");
  world.want({});
  world.give("layers/0.bin");
  time.now += 10;
  world.bytes("groups/0.bin", 10);
  time.now += 5000;
  world.bytes("groups/0.bin", 10);
  assert.deepEqual([world.givenUp, world.coming], [[], ["groups/0.bin"]]);
});

test("a slow renderer gets fewer points with the next requested group", () => {
  const world = new World({ groups: 5, renditions: ["high", "low"] });
  world.measure();
  world.stream.choose("high");
  world.give("groups/0.bin");
  world.stream.choose(null);
  world.stream.judge(true);
  world.give(...world.coming);
  assert.deepEqual(world.coming, ["groups/3.low.bin", "groups/4.low.bin"]);
});

test("memory for groups grows with the device's memory, within bounds", () => {
  for (const [gigabytes, mebibytes] of [
    [0.25, 64],
    [2, 128],
    [8, 512],
    [64, 512],
  ]) {
    device.deviceMemory = gigabytes;
    assert.equal(memoryBudget(), mebibytes * 2 ** 20);
  }
});

const here: Record<string, number> = { layer: 0, group: 0 };
const measure = (key: string): { bytes: number; here: number } => ({ bytes: 100, here: here[key] });

test("bytes received during a wait count until nothing is missing", () => {
  const awaited = new LoadProgress();
  assert.equal(awaited.progress(measure), 1);
  awaited.expect(["layer", "group"], ["layer", "group"]);
  assert.equal(awaited.progress(measure), 0);
  here.layer = 100;
  awaited.expect(["layer", "group"], ["group"]);
  here.group = 50;
  assert.equal(awaited.progress(measure), 0.75);
  here.group = 120; // it began anew
  assert.equal(awaited.progress(measure), 1);
  awaited.expect(["layer", "group"], []);
  assert.equal(awaited.progress(measure), 1);
});

test("progress of another wait begins at 0", () => {
  const awaited = new LoadProgress();
  awaited.expect(["layer", "group"], ["group"]);
  here.group = 0;
  assert.equal(awaited.progress(measure), 0, "the layer was there before");
  awaited.expect(["layer"], []);
  assert.equal(awaited.progress(measure), 1);
});
