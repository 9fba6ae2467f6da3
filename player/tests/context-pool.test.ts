import assert from "node:assert/strict";
import { test } from "node:test";
import { ContextPool, type ContextHolder } from "../src/element/context-pool";

class Player implements ContextHolder {
  idle = false;
  needed = false;
  awake = false;
  wake(): void {
    this.awake = true;
  }
  rest(): void {
    this.awake = false;
  }
}

const three = (): [ContextPool, Player[]] => [new ContextPool(2), [new Player(), new Player(), new Player()]];
const awake = (players: Player[]): boolean[] => players.map((player) => player.awake);

test("who comes last waits until one is idle, or leaves", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  assert.deepEqual(awake(players), [true, true, false]);
  players[1].idle = true;
  devices.review();
  assert.deepEqual(awake(players), [true, false, true]);
  devices.leave(players[0]);
  assert.deepEqual(awake(players), [false, true, true], "who gave its own back has it again");
});

test("a hand goes before those that play, and takes from who was used longest ago", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  devices.claim(players[0]); // used again
  devices.claim(players[2], true);
  assert.deepEqual(awake(players), [true, false, true]);
});

test("a hand waits for those that are needed", () => {
  const [devices, players] = three();
  players[0].needed = players[1].needed = true;
  for (const player of players) devices.claim(player, true);
  assert.deepEqual(awake(players), [true, true, false]);
  players[0].needed = false;
  players[0].idle = true;
  devices.review();
  assert.deepEqual(awake(players), [false, true, true]);
});

test("who leaves while it waits gets none", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  devices.leave(players[2]);
  devices.leave(players[0]);
  assert.deepEqual(awake(players), [false, true, false]);
});
