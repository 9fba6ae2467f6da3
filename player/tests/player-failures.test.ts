/** Failures of a player: files, manifests and graphics devices. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { DeviceLostError, PLAIN, ReelError } from "../packages/decoder/src/base/errors";
import { status, whole } from "./fakes/host";
import { device, page } from "./fakes/page";
import { FakePlayer, OFTEN, started } from "./fakes/player";
import { documentOf } from "./fakes/reel";

const { host, time } = FakePlayer;

test("a failed file is requested again after its pause, also while the image is still", async () => {
  const fake = new FakePlayer({ groups: 3 });
  await fake.open();
  fake.files.give("layers/0.bin", "groups/0.bin");
  fake.files.say("groups/1.bin", { error: "no" });
  await fake.pass(9000, 100);
  assert.ok(!fake.files.coming.includes("groups/1.bin"));
  await fake.pass(5000, 100);
  assert.ok(fake.files.coming.includes("groups/1.bin"));
});

test("a failed reel has a reason; a retry continues at the same time", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  fake.player.camera!.orbit(0.2, 0);
  const { viewmat } = fake.player.camera!;
  fake.files.say("groups/15.bin", { error: "groups/15.bin is damaged.", plain: PLAIN.damaged });
  assert.equal(fake.player.error, null, "the manifest is read again first");
  await time.pass(0);
  assert.deepEqual(fake.heard(...OFTEN), ["seeking", "error"]);
  assert.ok(fake.player.error instanceof ReelError && fake.player.error.plain === PLAIN.damaged);
  fake.files.give("groups/14.bin");
  fake.player.canvas.dispatchEvent(new Event("webglcontextlost"));
  assert.deepEqual(fake.heard(), [], "nothing is taken in any more, and one error is enough");
  fake.player.play();
  await fake.pass(200);
  assert.equal(fake.player.currentTime, 15, "nothing plays");
  page.dispatchEvent(new Event("online"));
  await time.pass(0);
  assert.deepEqual([fake.player.error, fake.player.currentTime], [null, 15]);
  assert.deepEqual(
    fake.player.camera!.viewmat.map((v) => v.toFixed(6)),
    viewmat.map((v) => v.toFixed(6)),
  );
  assert.deepEqual(fake.files.coming, ["layers/0.bin"]);
  fake.files.give("layers/0.bin");
  assert.deepEqual(fake.files.coming, ["groups/15.bin", "groups/14.bin"]);
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("a reel replaced on its host is opened again, at the same time and view", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  fake.player.camera!.orbit(0.2, 0);
  const { viewmat } = fake.player.camera!;
  for (const plain of [PLAIN.damaged, PLAIN.missing]) {
    fake.answer({ groups: 20, points: plain === PLAIN.damaged ? 50 : 60 });
    fake.files.say("groups/15.bin", { error: "groups/15.bin is another one.", plain });
    await time.pass(0);
    assert.deepEqual([fake.player.error, fake.player.currentTime], [null, 15]);
    assert.deepEqual(
      fake.player.camera!.viewmat.map((v) => v.toFixed(6)),
      viewmat.map((v) => v.toFixed(6)),
    );
    assert.deepEqual(fake.files.coming, ["layers/0.bin"]);
    fake.files.give("layers/0.bin");
  }
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("a missing manifest does not delay an error for long", async () => {
  const fake = await started({ groups: 20 });
  fake.player.currentTime = 15;
  fake.files.confirm();
  host.answer(() => new Response(new ReadableStream()));
  fake.files.say("groups/15.bin", { error: "groups/15.bin is damaged.", plain: PLAIN.damaged });
  await time.pass(9000);
  assert.equal((fake.player.error as ReelError).plain, PLAIN.damaged);
});

test("a missing manifest, a foreign manifest and a missing graphics device have their own messages", async () => {
  const fake = new FakePlayer();
  host.answer(status(404));
  await fake.open();
  assert.equal((fake.player.error as ReelError).plain, PLAIN.missing);
  host.answer(whole("{}"));
  fake.player.retry();
  await time.pass(0);
  assert.equal((fake.player.error as ReelError).plain, PLAIN.other);
  await assert.rejects(fake.player.whenReady(), { name: "ReelError" });
  const other = new FakePlayer();
  Object.assign(other.player.canvas, { getContext: () => null });
  await other.open();
  assert.equal((other.player.error as ReelError).plain, PLAIN.device);
});

test("playback continues after a lost graphics device, and the reel is not blamed", async () => {
  const fake = await started();
  fake.device.lost = true;
  fake.player.canvas.dispatchEvent(new Event("webglcontextlost"));
  assert.ok(fake.player.error instanceof DeviceLostError);
  fake.device.lost = false;
  fake.player.canvas.dispatchEvent(new Event("webglcontextrestored"));
  await time.pass(0);
  assert.equal(fake.player.error, null);
  fake.files.giveAll();
  await fake.pass(60);
  assert.equal(fake.player.canPlay, true);
});

test("a failure that follows from a lost device is reported as such", async () => {
  const fake = new FakePlayer();
  await fake.open();
  fake.device.lost = true;
  fake.files.say("layers/0.bin", { error: "no" });
  await time.pass(0);
  assert.ok(fake.player.error instanceof DeviceLostError);
});
