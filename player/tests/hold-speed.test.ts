import assert from "node:assert/strict";
import { test } from "node:test";
import { attachHoldSpeed } from "../packages/element/src/ui/controls";
import { FakePlayer, started } from "./fakes/player";

Object.assign(globalThis, { window: globalThis });

interface Surface {
  fake: FakePlayer;
  changes: boolean[];
  send(name: string, more?: object): void;
}

async function surfaceOf(): Promise<Surface> {
  const fake = await started({ groups: 60 });
  const [surface, changes] = [new EventTarget(), [] as boolean[]];
  attachHoldSpeed(surface as HTMLElement, fake.player, (fast) => void changes.push(fast), new AbortController().signal);
  const send = (name: string, more = {}): void =>
    void surface.dispatchEvent(
      Object.assign(new Event(name), {
        clientX: 10,
        clientY: 10,
        button: 0,
        shiftKey: false,
        isPrimary: true,
        ...more,
      }),
    );
  return { fake, changes, send };
}

test("a hold doubles the speed until it ends", async () => {
  const { fake, changes, send } = await surfaceOf();
  fake.player.playbackRate = 0.75;
  fake.player.play();
  send("pointerdown");
  await fake.pass(400);
  assert.equal(fake.player.playbackRate, 0.75);
  await fake.pass(200);
  assert.equal(fake.player.playbackRate, 1.5);
  send("pointermove", { clientX: 100 });
  assert.equal(fake.player.playbackRate, 1.5, "people may look around meanwhile");
  send("pointerup");
  assert.equal(fake.player.playbackRate, 0.75);
  assert.deepEqual(changes, [true, false]);
});

test("a tap, a drag, a pan, a second finger and a paused reel keep the speed", async () => {
  const { fake, changes, send } = await surfaceOf();
  fake.player.play();
  send("pointerdown");
  send("pointerup");
  await fake.pass(600);
  send("pointerdown");
  send("pointermove", { clientX: 40 });
  await fake.pass(600);
  send("pointerdown", { button: 2 });
  await fake.pass(600);
  send("pointerdown");
  send("pointerdown", { isPrimary: false });
  await fake.pass(600);
  fake.player.pause();
  send("pointerdown");
  await fake.pass(600);
  assert.equal(fake.player.playbackRate, 1);
  assert.deepEqual(changes, []);
});

test("a pause during a hold gives the speed back", async () => {
  const { fake, send } = await surfaceOf();
  fake.player.play();
  send("pointerdown");
  await fake.pass(600);
  assert.equal(fake.player.playbackRate, 2);
  fake.player.pause();
  assert.equal(fake.player.playbackRate, 1);
});
