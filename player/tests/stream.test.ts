import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { memoryBudget } from "../src/stream/file-cache";
import { device } from "./fakes/page";
import { time, World } from "./fakes/stream";

beforeEach(() => {
  time.now += 1_000_000;
});

test("layers come first and alone, then the group that shows, then those that follow, two at a time", () => {
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

test("the group that shows is asked for while the end of the last layer comes", () => {
  const world = new World();
  world.want({});
  time.now += 100;
  world.bytes("layers/0.bin", 100);
  assert.deepEqual(world.coming, ["layers/0.bin"]);
  time.now += 100;
  world.bytes("layers/0.bin", 350);
  assert.deepEqual(world.coming, ["layers/0.bin", "groups/0.bin"]);
});

test("a group is here only with its layers", () => {
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

test("eight seconds are had ahead, and no more", () => {
  const world = new World({ groups: 30 });
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.held, [...Array(9).keys()]);
  assert.deepEqual(world.stream.buffered, [[0, 9]]);
  world.want({ current: 1 });
  world.giveAll();
  assert.deepEqual(world.stream.held, [...Array(10).keys()]);
});

test("a seek gives up what comes for another time, and what shows then comes first", () => {
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

test("what comes is kept by a seek that needs it, and what comes later makes way", () => {
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

test("in a cross-fade both groups are needed now", () => {
  const world = new World({ groups: 12 });
  world.want({ current: 5, previous: 4, frame: 51 });
  world.give("layers/0.bin");
  assert.deepEqual(world.coming, ["groups/5.bin", "groups/4.bin"]);
  world.give("groups/5.bin");
  assert.deepEqual(world.coming, ["groups/4.bin"]);
});

test("after the last group comes the first if the reel goes round, and nothing if it does not", () => {
  for (const [loop, next] of [[true, ["groups/0.bin", "groups/1.bin"]], [false, []]] as const) {
    const world = new World({ groups: 5 });
    world.want({ current: 4, loop });
    world.give("layers/0.bin", "groups/4.bin");
    assert.deepEqual(world.coming, next);
  }
});

test("memory limits what is had ahead, and what was seen longest ago goes first", () => {
  const world = new World({ groups: 20 }, 4);
  world.want({});
  world.giveAll();
  assert.deepEqual(world.stream.held, [0, 1, 2, 3]);
  world.want({ current: 2 });
  world.giveAll();
  assert.deepEqual(world.stream.held, [2, 3, 4, 5]);
  assert.deepEqual(world.log.filter((line) => line.startsWith("dropped")), ["dropped 0", "dropped 1"]);
});

test("nothing goes that is on screen, whatever memory there is, and the next group comes all the same", () => {
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

test("a file that nobody waits for may fail: it is left alone for ten seconds", () => {
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
  assert.deepEqual(world.log.filter((line) => line.startsWith("failed")), []);
});

test("what shows cannot be had: the stream says so, once, and ends", async () => {
  for (const uri of ["layers/0.bin", "groups/0.bin"]) {
    const world = new World();
    world.want({});
    if (uri.startsWith("groups")) world.give("layers/0.bin");
    world.say(uri, { error: `${uri} is not there.` });
    world.want({ current: 3 });
    await Promise.resolve();
    assert.deepEqual(world.log.filter((line) => line.startsWith("failed")), [`failed ${uri} is not there.`]);
    assert.deepEqual(world.coming, []);
  }
});

test("a reel that is another one by now is no failure", async () => {
  const world = new World();
  world.want({});
  world.outdated = () => Promise.resolve(true);
  world.say("layers/0.bin", { error: "layers/0.bin is not there." });
  await Promise.resolve();
  assert.deepEqual([world.log, world.coming], [[], []]);
});

test("why it is late is told until bytes come again", () => {
  const world = new World();
  world.want({});
  world.say("layers/0.bin", { trouble: "Trying again." });
  assert.equal(world.stream.trouble, "Trying again.");
  world.bytes("layers/0.bin", 1);
  assert.equal(world.stream.trouble, null);
});

test("progress is the part that came of the bytes that are waited for", () => {
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

test("a line that is fast gets the best rendition, one that is slow the least", () => {
  for (const [milliseconds, name] of [[1, ""], [100_000, ".low"]] as const) {
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

test("a rendition that people choose shows from the next group on, also where others are here", () => {
  const world = new World({ groups: 3, renditions: ["high", "low"] });
  world.measure();
  world.giveAll();
  assert.deepEqual([0, 1, 2].map((group) => world.stream.renditionOf(group)), ["high", "high", "high"]);
  world.log.length = 0;
  world.stream.choose("low");
  assert.deepEqual(world.coming, ["groups/1.low.bin", "groups/2.low.bin"]);
  world.giveAll();
  assert.deepEqual([0, 1, 2].map((group) => world.stream.renditionOf(group)), ["high", "low", "low"]);
  assert.deepEqual(world.log, ["dropped 1", "group 1", "dropped 2", "group 2"], "what is here goes only once the other has come");
});

test("another rendition of a group that shows by now comes too late", () => {
  const world = new World({ groups: 3, renditions: ["high", "low"] });
  world.measure();
  world.giveAll();
  world.stream.choose("low");
  world.want({ current: 1, inUse: [1] });
  assert.deepEqual(world.givenUp, ["groups/1.low.bin"]);
  assert.deepEqual(world.coming, ["groups/2.low.bin"]);
  world.confirm();
  world.giveAll();
  assert.deepEqual([1, 2].map((group) => world.stream.renditionOf(group)), ["high", "low"]);
});

test("a group that is waited for and comes too slowly is taken in the least rendition", () => {
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

test("who chose a rendition gets it, however long it takes", () => {
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

test("a device that draws too slowly gets fewer points with the next group that is asked for", () => {
  const world = new World({ groups: 5, renditions: ["high", "low"] });
  world.measure();
  world.stream.choose("high");
  world.give("groups/0.bin");
  world.stream.choose(null);
  world.stream.judge(true);
  world.give(...world.coming);
  assert.deepEqual(world.coming, ["groups/3.low.bin", "groups/4.low.bin"]);
});

test("memory for groups grows with the device's, within bounds", () => {
  for (const [gigabytes, mebibytes] of [[0.25, 64], [2, 128], [8, 512], [64, 512]]) {
    device.deviceMemory = gigabytes;
    assert.equal(memoryBudget(), mebibytes * 2 ** 20);
  }
});
