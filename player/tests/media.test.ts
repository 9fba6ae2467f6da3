import assert from "node:assert/strict";
import { test } from "node:test";
import { timesOf } from "../packages/element/src/element/media-fragment";
import { stepSection } from "../packages/element/src/ui/section";
import { started } from "./fakes/player";

test("times of a fragment are seconds, minutes or hours, with or without an end", () => {
  const cases: [string, number | null, number | null][] = [
    ["a/manifest.json", null, null],
    ["a/manifest.json#t=1.5", 1.5, null],
    ["a/manifest.json#t=1.5,3", 1.5, 3],
    ["a/manifest.json#t=,3", null, 3],
    ["a/manifest.json#t=npt:0:01.5,1:00:00", 1.5, 3600],
    ["a/manifest.json#view=0&t=10s", 10, null],
    ["a/manifest.json?t=4", null, null],
    ["a/manifest.json#t=3,1", 3, null],
    ["a/manifest.json#t=-1", null, null],
    ["a/manifest.json#t=NaN,x", null, null],
  ];
  for (const [address, start, end] of cases) assert.deepEqual(timesOf(address), { start, end }, address);
});

test("three steps choose the start and the end of a section, and clear it", async () => {
  const { player } = await started({ groups: 60 });
  const said: string[] = [];
  const step = (seconds: number): void => {
    player.currentTime = seconds;
    stepSection(player, (words) => said.push(words));
  };
  step(2);
  assert.equal(player.section, null);
  step(5);
  assert.deepEqual([player.section, player.currentTime], [[2, 5], 2]);
  step(3);
  assert.equal(player.section, null);
  step(4);
  step(1);
  assert.equal(player.section, null, "an end before the start chooses nothing");
  step(1);
  step(2);
  assert.deepEqual(player.section, [1, 2]);
  assert.match(said[1], /0:02.0 to 0:05.0/);
});
