import assert from "node:assert/strict";
import { test } from "node:test";
import { PLAIN } from "../packages/decoder/src/base/errors";
import { FakePlayer, pointsOf } from "./fakes/player";
import { FakeWorker } from "./fakes/workers";

const view = {
  viewmat: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1],
  fx: 100,
  fy: 100,
  cx: 80,
  cy: 45,
  width: 160,
  height: 90,
  near: 0.01,
};
const scene = (group: number) => ({ layers: ["layers/0.bin"], current: { group, frame: 0 }, previous: null });
/** A stage with all that shows, and a sort worker that answers when it is told to. */
async function stageOf(): Promise<{ stage: FakePlayer["stage"]; answer: () => void }> {
  const fake = new FakePlayer({ groups: 3 });
  await fake.start();
  fake.player.show(false);
  await fake.pass(100);
  let answer = (): void => undefined;
  const posted = FakeWorker.posted!;
  FakeWorker.posted = (worker, message) => {
    if ((message as { type?: string }).type === "sort")
      answer = () => ((FakeWorker.posted = posted), posted(worker, message));
    else posted(worker, message);
  };
  return { stage: fake.stage, answer: () => answer() };
}

test("the drawn order changes with the sort worker's answer, one request at a time", async () => {
  const { stage, answer } = await stageOf();
  stage.invalidate();
  assert.equal(stage.wantsSort, true);
  const sorted = stage.sort(scene(1), view);
  assert.deepEqual([stage.wantsSort, stage.scene!.current!.group, stage.inUse], [false, 0, [0, 1]]);
  stage.invalidate();
  assert.equal(stage.wantsSort, false, "the worker is at it");
  answer();
  assert.equal(await sorted, true);
  assert.deepEqual([stage.wantsSort, stage.scene!.current!.group, stage.inUse], [true, 1, [1]]);
});

test("an order of a dropped group is not drawn", async () => {
  const { stage, answer } = await stageOf();
  const sorted = stage.sort(scene(1), view);
  answer();
  stage.dropGroup(1);
  assert.deepEqual([await sorted, stage.scene!.current!.group], [false, 0]);
});

test("a dropped layer is not drawn, and its memory is reused", async () => {
  const { stage, answer } = await stageOf();
  const file = pointsOf(1000, 0, 0) as Parameters<typeof stage.addLayer>[1];
  for (let i = 0; i < 500; i++) {
    stage.addLayer(`layers/${i + 1}.bin`, file);
    if (i >= 3) stage.dropLayer(`layers/${i - 2}.bin`);
  }
  const sorted = stage.sort({ ...scene(1), layers: ["layers/0.bin", "layers/498.bin"] }, view);
  answer();
  stage.dropLayer("layers/498.bin");
  assert.deepEqual([await sorted, stage.scene!.current!.group], [false, 0]);
  stage.draw(0, view); // what was dropped is left out
});

test("memory of dropped groups is reused, and too little memory is reported as the device's limit", async () => {
  const { stage } = await stageOf();
  const file = pointsOf(1000, 1, 100) as Parameters<typeof stage.addGroup>[1];
  for (let i = 0; i < 500; i++) {
    stage.addGroup(1000 + i, file, []);
    if (i >= 3) stage.dropGroup(1000 + i - 3);
  }
  assert.throws(
    () => {
      for (let i = 0; i < 500; i++) stage.addGroup(20_000 + i, file, []);
    },
    { name: "ReelError", plain: PLAIN.device, message: /more points than this device draws/ },
  );
});
