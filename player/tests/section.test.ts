import assert from "node:assert/strict";
import { test } from "node:test";
import { stepSection } from "../packages/element/src/ui/section";
import { started } from "./fakes/player";

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
