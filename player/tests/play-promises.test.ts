import assert from "node:assert/strict";
import { test } from "node:test";
import { PlayPromises } from "../packages/renderer/src/playback/play-promises";
import { status } from "./fakes/host";
import { FakePlayer } from "./fakes/player";

const { host, time } = FakePlayer;

test("play() resolves once time advances, also for later callers", async () => {
  const fake = new FakePlayer({ groups: 3 });
  const promises = new PlayPromises(fake.player, () => fake.player.play());
  await fake.open();
  let played = 0;
  const first = promises.play().then(() => played++);
  const second = promises.play().then(() => played++);
  await fake.pass(200);
  assert.equal(played, 0);
  fake.files.giveAll();
  await fake.pass(200);
  await Promise.all([first, second]);
  await promises.play();
  assert.equal(played, 2);
});

test("play() rejects with the error name of media elements if it cannot start", async () => {
  const fake = new FakePlayer({ groups: 3 });
  const promises = new PlayPromises(fake.player, () => fake.player.play());
  await assert.rejects(promises.play(), { name: "NotSupportedError", message: /address is missing/ });
  const cases: [string, () => void][] = [
    ["AbortError", () => fake.player.pause()],
    ["AbortError", () => fake.player.close()],
    ["NotAllowedError", () => fake.player.emit("notallowed")],
  ];
  for (const [name, act] of cases) {
    await fake.open();
    const refused = assert.rejects(promises.play(), { name });
    act();
    await refused;
    fake.player.pause();
  }
  host.answer(status(404));
  const refused = assert.rejects((void fake.player.load("https://page.example/none.json"), promises.play()), {
    name: "NotSupportedError",
    message: /none\.json cannot be downloaded/,
  });
  await time.pass(0);
  await refused;
  await assert.rejects(promises.play(), { name: "NotSupportedError", message: /none\.json/ });
});
