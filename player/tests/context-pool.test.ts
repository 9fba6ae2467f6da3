import assert from "node:assert/strict";
import { test } from "node:test";
import { type ContextHolder, ContextPool } from "../packages/element/src/element/visibility";

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

test("the latest request waits until a context is idle or released", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  assert.deepEqual(awake(players), [true, true, false]);
  players[1].idle = true;
  devices.review();
  assert.deepEqual(awake(players), [true, false, true]);
  devices.leave(players[0]);
  assert.deepEqual(awake(players), [false, true, true], "who gave its own back has it again");
});

test("user input outranks playback, and takes the least recently used context", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  devices.claim(players[0]); // used again
  devices.claim(players[2], true);
  assert.deepEqual(awake(players), [true, false, true]);
});

test("user input waits while all contexts are needed", () => {
  const [devices, players] = three();
  players[0].needed = players[1].needed = true;
  for (const player of players) devices.claim(player, true);
  assert.deepEqual(awake(players), [true, true, false]);
  players[0].needed = false;
  players[0].idle = true;
  devices.review();
  assert.deepEqual(awake(players), [false, true, true]);
});

test("a waiting element that is removed gets no context", () => {
  const [devices, players] = three();
  for (const player of players) devices.claim(player);
  devices.leave(players[2]);
  devices.leave(players[0]);
  assert.deepEqual(awake(players), [false, true, false]);
});
