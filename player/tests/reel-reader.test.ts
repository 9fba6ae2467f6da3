import assert from "node:assert/strict";
import { test } from "node:test";
import { LocalFiles } from "../packages/decoder/src/files/local-files";
import { pointsAt } from "../packages/decoder/src/reader/points";
import { ReelReader } from "../packages/decoder/src/reader/reel-reader";
import { decodeWorkers } from "../packages/renderer/src/files/bundle";
import { pointsAt as fileOf, pointsOf } from "./fakes/player";
import { documentOf, pageAt, type Plan } from "./fakes/reel";
import { settled } from "./fakes/time";
import { FakeWorker, Transfers } from "./fakes/workers";

function filesOf(uri: string, plan: Plan): object {
  return uri.startsWith("pages") ? pageAt(plan, uri) : fileOf(plan, uri);
}

/** Open a reel whose files come when a test says so. */
async function open(plan: Plan, options: object = {}): Promise<{ reader: ReelReader; transfers: Transfers }> {
  const manifest = JSON.stringify(documentOf(plan));
  const source = new LocalFiles("reel", (uri) => ({
    blob: new Blob(uri === "manifest.json" ? [manifest] : []),
    deflated: false,
  }));
  FakeWorker.all.length = 0;
  return {
    reader: await ReelReader.open(source, decodeWorkers, options),
    transfers: new Transfers((uri) => filesOf(uri, plan)),
  };
}

test("a frame waits for its files, and shows static and dynamic points", async () => {
  const { reader, transfers } = await open({ groups: 3 });
  const frame = reader.frame(0.5);
  await settled();
  transfers.giveAll();
  const { count, groups, seconds, means } = await frame;
  assert.deepEqual({ count, groups, seconds }, { count: 200, groups: [0], seconds: 0.5 });
  assert.equal(means.length, 600);
  reader.close();
});

test("a cross-fade shows both groups", async () => {
  const { reader, transfers } = await open({ groups: 3, overlap: 2 });
  const frame = reader.frame(1.1);
  await settled();
  transfers.giveAll();
  const { count, groups, opacities } = await frame;
  assert.deepEqual({ count, groups }, { count: 300, groups: [0, 1] });
  assert.ok(
    opacities.slice(100).every((opacity) => opacity < 0.5),
    "half of the weight each",
  );
  reader.close();
});

test("times are clamped to the reel, and NaN is refused", async () => {
  const { reader, transfers } = await open({ groups: 2 });
  const frame = reader.frame(99);
  await settled();
  transfers.giveAll();
  assert.equal((await frame).seconds, 1.9);
  await assert.rejects(reader.frame(NaN), /NaN/);
  reader.close();
});

test("a rendition that the reel lacks is refused, and the best one is the default", async () => {
  await assert.rejects(
    open({ renditions: ["high", "low"] }, { rendition: "medium" }),
    /has no rendition medium. It has high, low/,
  );
  const { reader, transfers } = await open({ renditions: ["high", "low"] });
  reader.seek(0);
  assert.ok(transfers.coming.every((uri) => !uri.includes("low")));
  reader.close();
});

test("a file that fails rejects the frame, and so does closing", async () => {
  const { reader, transfers } = await open({ groups: 2 });
  const frame = reader.frame(0);
  await settled();
  transfers.say(transfers.coming[0], { error: "layers/0.bin is damaged" });
  await assert.rejects(frame, /layers\/0.bin is damaged/);
  reader.close();
  const { reader: other } = await open({ groups: 2 });
  const waiting = other.frame(0);
  await settled();
  other.close();
  await assert.rejects(waiting, /closed/);
});

test("light scales the color, not the harmonics' deviation from gray alone", () => {
  const layer = pointsOf(1, 0, 0) as { kind: "layer"; points: never };
  const group = { ...(pointsOf(1, 2, 1) as object), light: Float32Array.from([0.5, 0.5, 0.5, 0.5, 0.5, 0.5]) } as never;
  const { sh } = pointsAt({ group, layers: [{ uri: "a", file: layer }], frame: 0 }, null, 1);
  assert.ok(Math.abs(0.5 + 0.28209479177387814 * sh[0] - 0.25) < 1e-6, "half of gray");
});
