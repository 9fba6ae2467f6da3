/** Streaming reels of version 2: pages, layers that are retired, groups that are dropped. */
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { PLAIN } from "../packages/decoder/src/base/errors";
import { withKnown } from "../packages/decoder/src/reel/pages";
import { costOf } from "../packages/decoder/src/stream/file-cache";
import { manifestOf, type Plan } from "./fakes/reel";
import { GROUP, time, World } from "./fakes/stream";

/** Chapters of four groups, each with a layer of its own; and a layer that all share. */
const chapters = (groups: number): Plan["layers"] => [
  0,
  ...Array.from({ length: Math.ceil(groups / 4) }, (_, i): [number, number] => [4 * i, 4 * i + 4]),
];
const LAYER = costOf({ points: 100, frames: 0 });

beforeEach(() => {
  time.now += 1_000_000;
});

test("a late viewer loads only the layers that live at the time", () => {
  const world = new World({ groups: 40, layers: chapters(40) });
  world.want({ current: 21, frame: 215 });
  assert.deepEqual(world.coming, ["layers/0.bin", "layers/6.bin"]);
  world.give("layers/0.bin", "layers/6.bin", "groups/21.bin");
  assert.equal(world.stream.has(21), true);
});

test("a cross-fade of chapters needs the layers of both", () => {
  const world = new World({ groups: 40, layers: chapters(40) });
  world.want({ current: 8, previous: 7, frame: 81 });
  world.give("layers/0.bin", "layers/3.bin");
  assert.deepEqual(world.stream.loadedLayers, ["layers/0.bin", "layers/3.bin"]);
  world.give("layers/2.bin", "groups/8.bin");
  assert.deepEqual([world.stream.has(8), world.stream.has(7)], [true, false]);
  world.give("groups/7.bin");
  assert.equal(world.stream.has(7), true);
});

test("a retired layer is dropped with the last group at which it lives", () => {
  const world = new World({ groups: 12, layers: chapters(12) }, 4);
  world.want({ current: 2 });
  world.giveAll();
  assert.deepEqual(
    world.log.filter((line) => line.startsWith("layer")),
    ["layer 0", "layer 1", "layer 2"],
  );
  world.want({ current: 4 });
  world.giveAll();
  assert.deepEqual(
    world.log.filter((line) => line.startsWith("dropped")),
    ["dropped 2", "dropped 3", "dropped layers/1.bin"],
  );
  assert.deepEqual([world.stream.has(3), world.stream.has(4)], [false, true]);
  world.want({ current: 3 });
  assert.deepEqual(world.coming, ["layers/1.bin"], "who goes back gets it again");
});

test("an hour is played within the memory for groups", () => {
  const world = new World({ groups: 3600, layers: chapters(3600), page: 64 }, 12);
  let [most, here] = [0, 0];
  const held = new Set<string>();
  for (let current = 0; current < 3600; current++) {
    for (const previous of [current === 0 ? null : current - 1, null]) {
      world.want({
        current: null,
        previous: null,
        inUse: [current],
        frame: 10 * current + (previous === null ? 5 : 1),
      });
      world.look();
      world.giveAll();
      assert.ok(world.stream.has(current) && (previous === null || world.stream.has(previous)), String(current));
    }
    for (const line of world.log.splice(0)) {
      const name = line
        .replace("dropped ", "")
        .replace(/^(\d+)$/, "group $1")
        .replace(/layers.(\d+).bin/, "layer $1");
      if (line.startsWith("dropped")) assert.ok(held.delete(name), line);
      else held.add(name);
    }
    here = [...held].reduce((sum, name) => sum + (name.startsWith("group") ? GROUP : LAYER), 0);
    most = Math.max(most, here);
  }
  assert.ok(most <= 12 * GROUP + 2 * LAYER, `${most / GROUP} groups' worth`);
  assert.ok(held.has("layer 0") && !held.has("layer 1"));
});

test("a page is requested once, when one of its groups is needed, with the layers needed anyway", () => {
  const world = new World({ groups: 300, page: 64, layers: [0, 100, [150, 160], 299] });
  world.want({ current: null, frame: 1520 });
  assert.deepEqual(world.coming, ["pages/128.json", "layers/0.bin"]);
  assert.equal(world.stream.progress, 0);
  world.give("layers/0.bin");
  assert.equal(world.stream.progress, 500 / 1200, "of two layers and the page");
  world.give("pages/128.json");
  assert.deepEqual(world.coming, ["layers/1.bin", "layers/2.bin"]);
  world.giveAll();
  assert.equal(world.stream.has(152), true);
});

test("a seek far ahead costs one page more than one at the beginning", () => {
  const asked = (group: number): number => {
    const world = new World({ groups: 10_100, page: 64 });
    let files = 0;
    world.want({ current: null, frame: 10 * group + 5 });
    world.look();
    for (; !world.stream.has(group); files++) world.give(world.coming[0]);
    return files;
  };
  assert.deepEqual(
    [asked(1), asked(10_000), asked(10_099)],
    [3, 3, 2],
    "a page, a layer and a group; the manifest lists the last ones itself",
  );
});

test("the page of the next group is loaded in time", () => {
  const world = new World({ groups: 20, page: 8 });
  world.want({ current: null, frame: 75 });
  world.give("pages/0.json", "layers/0.bin");
  assert.deepEqual(world.coming, ["groups/7.bin"], "what shows has the whole line");
  world.give("groups/7.bin");
  assert.deepEqual(world.coming, ["pages/8.json"]);
  world.give("pages/8.json");
  assert.deepEqual(world.coming, ["groups/8.bin", "groups/9.bin"]);
});

test("a prefetched page may fail, a needed page may not", async () => {
  const world = new World({ groups: 20, page: 8 });
  world.want({ current: null, frame: 75 });
  world.give("pages/0.json");
  world.want({ current: 7 });
  world.give("layers/0.bin", "groups/7.bin");
  world.say("pages/8.json", { error: "no" });
  world.want({ current: 7 });
  assert.deepEqual([world.coming, world.log.filter((line) => line.startsWith("failed"))], [[], []]);
  world.want({ current: null, frame: 80 });
  world.say("pages/8.json", { error: "pages/8.json is not there." });
  await Promise.resolve();
  assert.deepEqual(
    world.log.filter((line) => line.startsWith("failed")),
    ["failed pages/8.json is not there."],
  );
});

test("a file dropped by a live reel is not a failure once the manifest lacks it", async () => {
  const plan: Plan = { groups: 30, live: true, first: 10 };
  for (const [first, failures] of [
    [12, 0],
    [10, 1],
  ] as const) {
    const world = new World(plan);
    world.want({ current: 10 });
    world.give("layers/0.bin");
    world.outdated = async () => {
      world.grow(manifestOf({ ...plan, groups: 32, first }));
      if (first > 10) world.want({ current: first });
      return false;
    };
    world.say("groups/10.bin", { error: "groups/10.bin is gone.", plain: PLAIN.missing });
    world.want({});
    assert.deepEqual(world.coming, [], "it is not asked for meanwhile");
    await Promise.resolve();
    await Promise.resolve();
    assert.equal(world.log.filter((line) => line.startsWith("failed")).length, failures);
    assert.deepEqual(world.coming, failures > 0 ? [] : ["groups/12.bin"]);
  }
});

test("groups before the window are dropped even if there is memory", () => {
  const plan: Plan = { groups: 8, live: true, first: 2 };
  const world = new World(plan);
  world.want({ current: 2 });
  world.giveAll();
  assert.deepEqual(world.stream.held, [2, 3, 4, 5, 6, 7]);
  world.grow(manifestOf({ ...plan, first: 5 }));
  assert.deepEqual(world.stream.buffered, [[5, 8]]);
  world.want({ current: 5, inUse: [3] });
  assert.deepEqual(world.stream.held, [3, 5, 6, 7], "one is still on screen");
  world.want({ current: 5, inUse: [5] });
  assert.deepEqual(world.stream.held, [5, 6, 7]);
});

test("a looping reel continues at its first frame", () => {
  const world = new World({ groups: 12, first: 7, layers: [0, [7, 9]] });
  world.want({ current: 11, loop: true });
  world.give("layers/0.bin", "groups/11.bin");
  assert.deepEqual(world.coming, ["layers/1.bin", "groups/7.bin"]);
});
