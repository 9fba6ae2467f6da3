import assert from "node:assert/strict";
import { test } from "node:test";
import type { Player } from "../packages/element/src/player/player";
import { LINES } from "../packages/element/src/ui/help";
import { type Actions, attachKeys } from "../packages/element/src/ui/keys";
import { page } from "./fakes/page";
import { FakePlayer, started } from "./fakes/player";
import { attachHoldSpeed } from "../packages/element/src/ui/controls";

/** An element that has the keys. */
class Target extends EventTarget {
  isContentEditable = false;
  constructor(private readonly kind: string) {
    super();
  }
  /** Of a list of selectors, whether one is this kind. */
  matches(selectors: string): boolean {
    return selectors
      .split(/,\s*(?![^(]*\))/)
      .some((selector) =>
        selector.startsWith("input:not")
          ? this.kind === "input[type=text]"
          : this.kind.includes(selector.split(":")[0]),
      );
  }
}
Object.assign(globalThis, { HTMLElement: Target });

interface Keyboard {
  fake: FakePlayer;
  done: string[];
  /** Whether the page was kept from doing anything with the key. */
  press(key: string, more?: object, target?: EventTarget): boolean;
  release(key: string): void;
}

/** refused: actions that have no effect. */
async function keyboard(refused: string[] = [], open = true): Promise<Keyboard> {
  const fake = new FakePlayer({ groups: 60 });
  if (open) await fake.start();
  const [host, done] = [new EventTarget(), [] as string[]];
  const actions = Object.fromEntries(
    "toggle fullscreen headset reset fly walk statistics picture help escape section volume context"
      .split(" ")
      .map((name) => [name, () => (done.push(name), !refused.includes(name))]),
  );
  const life = new AbortController();
  attachKeys(host as HTMLElement, fake.player, actions as unknown as Actions, life.signal);
  const send = (type: string, key: string, more: object, target: EventTarget): boolean => {
    const event = Object.assign(new Event(type, { cancelable: true }), {
      key,
      code: `Key ${key}`,
      ctrlKey: false,
      metaKey: false,
      altKey: false,
      shiftKey: false,
      ...more,
    });
    Object.assign(event, { composedPath: () => [target] });
    if (target instanceof Target) target.dispatchEvent(event);
    host.dispatchEvent(event);
    return event.defaultPrevented;
  };
  return {
    fake,
    done,
    press: (key, more = {}, target = host) => send("keydown", key, more, target),
    release: (key) => void send("keyup", key, {}, host),
  };
}

test("keys seek within the reel", async () => {
  const { fake, press } = await keyboard();
  const times: [string, number][] = [
    ["5", 30],
    ["ArrowRight", 35],
    ["l", 45],
    ["j", 35],
    ["ArrowLeft", 30],
    ["End", 60],
    ["ArrowRight", 60],
    ["Home", 0],
    ["ArrowLeft", 0],
    [".", 0.1],
    [",", 0],
  ];
  for (const [key, seconds] of times) {
    assert.equal(press(key), true);
    assert.ok(Math.abs(fake.player.currentTime - seconds) < 1e-9, `${key}: ${fake.player.currentTime}`);
  }
});

test("faster and slower step through the rates, also from another rate", async () => {
  const { fake, press } = await keyboard();
  for (const [key, rate] of [
    [">", 1.25],
    [">", 1.5],
    [">", 2],
    [">", 2],
    ["<", 1.5],
  ] as const) {
    press(key);
    assert.equal(fake.player.playbackRate, rate);
  }
  fake.player.playbackRate = 0.6;
  press("<");
  assert.equal(fake.player.playbackRate, 0.5);
});

test("each action has a key, in lower and upper case", async () => {
  const { press, done } = await keyboard();
  for (const key of [" ", "K", "f", "v", "r", "c", "g", "i", "p", "?", "Escape"]) press(key);
  assert.equal(done.join(" "), "toggle toggle fullscreen headset reset fly walk statistics picture help escape");
  assert.equal(press("x"), false, "it means nothing here");
  done.length = 0;
  press("o");
  press("F10", { shiftKey: true });
  assert.deepEqual(done, ["section", "context"]);
});

test("the help describes all keys and no others", () => {
  const table = attachKeys(new EventTarget() as HTMLElement, {} as Player, {} as Actions, new AbortController().signal);
  assert.deepEqual(
    table.flat().map(({ bindings }) => bindings[0].keys[0]),
    Object.keys(LINES).sort((a, b) => order(a) - order(b)),
  );
  function order(key: string): number {
    return table.flat().findIndex(({ bindings }) => bindings[0].keys[0] === key);
  }
});

test("keys that do not apply to the reel are left to the page", async () => {
  const { fake, press, done } = await keyboard();
  for (const key of ["ArrowUp", "ArrowDown", "t", "n", "b"]) assert.equal(press(key), false, key);
  Object.defineProperty(fake.player.soundtrack, "available", { value: true });
  assert.equal(press("ArrowUp"), true);
  assert.deepEqual(done, ["volume"]);
});

test("keys of the browser and of the focused control are ignored", async () => {
  const { press, done } = await keyboard();
  for (const held of ["ctrlKey", "metaKey", "altKey"]) assert.equal(press("f", { [held]: true }), false);
  const text = new Target("input[type=text]");
  assert.equal(press("f", {}, text), false);
  assert.equal(press("Escape", {}, text), true);
  const button = new Target("button");
  for (const [key, ours] of [
    [" ", false],
    ["Enter", false],
    ["f", true],
  ] as const)
    assert.equal(press(key, {}, button), ours, key);
  assert.equal(press(" ", {}, new Target("[type=checkbox]")), false);
  assert.deepEqual(done, ["escape", "fullscreen"]);
});

test("the camera moves while keys are down, and stops when they are released or the page loses focus", async () => {
  const { fake, press, release } = await keyboard();
  const x = (): number => fake.player.camera!.viewmat[3];
  const moves = async (): Promise<number> => {
    const before = x();
    await fake.pass(1000);
    return before - x();
  };
  press("d");
  assert.ok((await moves()) > 0.5);
  press("a");
  await fake.pass(1000);
  assert.ok(Math.abs(await moves()) < 0.01, "both at a time are none");
  release("a");
  assert.ok((await moves()) > 0.3);
  page.dispatchEvent(new Event("blur"));
  await fake.pass(1000);
  assert.ok(Math.abs(await moves()) < 0.01);
});

test("keys that had no effect are left to the page", async () => {
  const { press, done } = await keyboard(["escape", "headset", "toggle"]);
  assert.deepEqual([press("Escape"), press("v"), press(" "), press("r")], [false, false, false, true]);
  assert.deepEqual(done, ["escape", "headset", "toggle", "reset"]);
});

test("without a reel, keys of time and view are left to the page", async () => {
  const { press, done } = await keyboard([], false);
  for (const key of ["ArrowLeft", "End", "5", "w", "o", "r", "p", "ArrowUp"]) assert.equal(press(key), false, key);
  for (const key of [" ", "f", "?", "Escape"]) assert.equal(press(key), true, key);
  assert.deepEqual(done, ["toggle", "fullscreen", "help", "escape"]);
});

test("keys that the page has used are not used again", async () => {
  const { press, done } = await keyboard();
  const button = new Target("div");
  button.addEventListener("keydown", (event) => event.preventDefault());
  assert.equal(press("f", {}, button), true);
  assert.deepEqual(done, []);
});

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
