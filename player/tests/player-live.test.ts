/** A player of a live reel. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { status, whole } from "./fakes/host";
import { FakePlayer } from "./fakes/player";
import { documentOf, type Plan } from "./fakes/reel";

const { host, time } = FakePlayer;

test("the player waits for the first group of a live reel, starts at its live edge, and follows it to its end", async () => {
  const fake = new FakePlayer({ groups: 0, layers: [], live: true });
  await fake.open();
  assert.match(fake.player.notice!, /Waiting for the first group/);
  fake.answer({ groups: 2, live: true });
  await fake.pass(3000);
  assert.deepEqual(
    [fake.player.notice, fake.player.live, fake.player.duration, fake.player.currentTime],
    [null, true, 2, 1],
  );
  fake.files.giveAll();
  await fake.pass(60);
  fake.player.play();
  await fake.pass(1500);
  assert.deepEqual(
    [fake.player.currentTime, fake.player.paused, fake.player.ended],
    [2, false, false],
    "it waits at its edge",
  );
  fake.heard();
  fake.plan = { groups: 3, live: true, layers: [0, 2] };
  host.answer(status(500), status(500), status(500), whole(JSON.stringify(documentOf(fake.plan))));
  await fake.pass(12_000);
  assert.equal(fake.player.duration, 3);
  assert.ok(fake.heard().includes("durationchange"));
  assert.deepEqual(fake.files.coming.sort(), ["layers/1.bin"]);
  fake.files.giveAll();
  fake.answer({ groups: 3, layers: [0, 2] });
  await fake.pass(6000);
  assert.deepEqual([fake.player.live, fake.player.ended], [false, true]);
  host.asked.length = 0;
  await fake.pass(10_000, 100);
  assert.equal(host.asked.length, 0, "what is whole does not grow");
});

test("a live reel whose first group was replaced is opened again with the same view", async () => {
  const preview = { groups: 1, live: true, layerBytes: 500 };
  const fake = new FakePlayer(preview);
  await fake.open();
  fake.files.giveAll();
  await fake.pass(60);
  fake.player.camera!.orbit(0.2, 0);
  const { viewmat } = fake.player.camera!;
  host.answer(whole(JSON.stringify(documentOf(preview))));
  fake.heard();
  await fake.pass(3000);
  assert.ok(!fake.heard().includes("loadstart"), "nothing has changed");
  const next = JSON.stringify(documentOf({ groups: 2, live: true, layerBytes: 900 }));
  host.answer(whole(next), whole(next));
  await fake.pass(3000);
  assert.ok(fake.heard().includes("loadstart"));
  assert.deepEqual([fake.player.duration, fake.player.error], [2, null]);
  assert.deepEqual(
    fake.player.camera!.viewmat.map((v) => v.toFixed(6)),
    viewmat.map((v) => v.toFixed(6)),
  );
});

test("a closed live reel sends no more requests", async () => {
  const fake = new FakePlayer({ groups: 2, live: true });
  await fake.open();
  fake.player.close();
  await fake.pass(10_000, 100);
  assert.ok(host.asked.length <= 2, `${host.asked.length} requests`);
});

test("a pending request of a closed live reel is ignored", async () => {
  const fake = new FakePlayer({ groups: 2, live: true });
  await fake.open();
  let answer = (): void => undefined;
  host.answer(
    () =>
      new Response(
        new ReadableStream({
          start: (controller) =>
            void (answer = () => (
              controller.enqueue(new TextEncoder().encode(JSON.stringify(documentOf({ groups: 3, live: true })))),
              controller.close()
            )),
        }),
      ),
  );
  await fake.pass(3000, 100);
  assert.equal(host.asked.length, 1);
  fake.player.close();
  fake.heard();
  answer();
  await time.pass(10_000);
  assert.deepEqual([fake.heard(), fake.player.duration, host.asked.length], [[], 0, 1]);
});
