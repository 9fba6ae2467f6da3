import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { beforeEach, test } from "node:test";
import { pathToFileURL } from "node:url";
import { PLAIN } from "../packages/decoder/src/base/errors";
import type { DecodedFile } from "../packages/decoder/src/decode/decode-file";
import type { DecodeReply, DecodeRequest } from "../packages/decoder/src/decode/decode-worker";
import { FakeHost, pieces, status, whole } from "./fakes/host";
import "./fakes/page";
import { FakeTime } from "./fakes/time";
import { FakeWorker } from "./fakes/workers";
import "../packages/decoder/src/decode/decode-worker";

const packages = join(process.cwd(), "node_modules");
const golden = (path: string): Uint8Array => new Uint8Array(readFileSync(join(process.cwd(), "../tests/data", path)));
const time = new FakeTime();
const host = new FakeHost();
let said: DecodeReply[] = [];
let handedOver: Transferable[] = [];
const scope = Object.assign(
  globalThis as unknown as { onmessage(event: { data: DecodeRequest }): Promise<void>; location: URL },
  {
    postMessage: (reply: DecodeReply, transfer: Transferable[] = []) => {
      said.push(reply);
      handedOver.push(...transfer);
    },
  },
);
const files = Object.fromEntries(
  Object.entries({
    "draco-decode.js": "draco_decoder_nodejs.js",
    "draco_decoder.wasm": "draco_decoder.wasm",
    "hevc-worker.js": "hevc-worker.js",
  }).map(([name, source]) => [name, pathToFileURL(join(packages, "draco3d", source)).href]),
);
files["paper-decode.js"] = pathToFileURL(join(process.cwd(), "packages/decoder/src/decode/paper-decode.ts")).href;
await import(files["paper-decode.js"]); // it takes longer than the fake time waits
void scope.onmessage({ data: { files } });
/** Ask for a file of this content. */
const ask = (id: number, content: Uint8Array | string, page = false): Promise<void> => {
  const sha256 = createHash("sha256").update(content).digest("hex");
  return scope.onmessage({
    data: { id, source: { url: "https://page.example/groups/0.bin", bytes: content.length, sha256 }, page },
  });
};
/** Of one request: the bytes that were told of, then what else was said. */
const replies = (id: number): [number, object[]] => {
  const own = said.filter((reply) => reply.id === id);
  const received = own.reduce((sum, reply) => sum + ("received" in reply ? reply.received : 0), 0);
  return [received, own.filter((reply) => !("received" in reply))];
};
const fileOf = (id: number): DecodedFile =>
  (replies(id)[1].at(-1) as { file?: DecodedFile }).file ?? assert.fail(JSON.stringify(replies(id)));

beforeEach(() => {
  FakeWorker.all.length = said.length = handedOver.length = 0;
});

test("a file is fetched with progress, decoded, and transferred without a copy", async () => {
  const bytes = golden("golden-predictive/groups/0000.safetensors");
  host.answer(pieces([bytes.slice(0, 1000), bytes.slice(1000)], "over"));
  await time.until(ask(1, bytes));
  const file = fileOf(1);
  assert.equal(replies(1)[0], bytes.length);
  assert.ok(file.points.count > 0 && file.points.means.every(Number.isFinite) && file.offsets!.frames > 1);
  for (const array of [file.points.means, file.points.quats, file.alive, file.offsets!.dx])
    assert.ok(handedOver.includes(array.buffer as ArrayBuffer));
  assert.equal(new Set(handedOver).size, handedOver.length);
});

test("network trouble is reported, and a failed fetch or decode has a reason", async () => {
  const bytes = golden("golden-predictive/layers/0000.safetensors");
  host.answer(status(503), whole(bytes));
  await time.until(ask(2, bytes));
  const [trouble, done] = replies(2)[1];
  assert.match((trouble as { trouble: string }).trouble, /^Retrying/);
  assert.ok("file" in done);
  host.answer(status(404));
  await time.until(ask(3, bytes));
  assert.deepEqual(replies(3)[1], [
    { id: 3, error: "https://page.example/groups/0.bin cannot be downloaded: it answered 404.", plain: PLAIN.missing },
  ]);
  const damaged = bytes.map((byte, i) => (i > bytes.length / 2 ? byte ^ 255 : byte));
  host.answer(whole(damaged));
  await time.until(ask(4, damaged));
  const [failure] = replies(4)[1] as { error: string; plain: string }[];
  assert.match(failure.error, /^https:\/\/page\.example\/groups\/0\.bin cannot be played: section/);
  assert.equal(failure.plain, PLAIN.damaged);
});

test("a page is read as JSON; anything else is an error", async () => {
  host.answer(whole('{"groups": [1]}'));
  await time.until(ask(10, '{"groups": [1]}', true));
  assert.deepEqual(replies(10), [15, [{ id: 10, page: { groups: [1] } }]]);
  host.answer(whole('{"groups": [1]'));
  await time.until(ask(11, '{"groups": [1]', true));
  assert.deepEqual(replies(11)[1], [
    { id: 11, error: "https://page.example/groups/0.bin is damaged: it is not JSON.", plain: PLAIN.damaged },
  ]);
});

test("a canceled file ends, and another continues", async () => {
  const bytes = golden("golden-predictive/layers/0000.safetensors");
  host.answer(pieces([bytes.slice(0, 100)], "silent"), whole(bytes));
  const [given, kept] = [ask(5, bytes), ask(6, bytes)];
  await time.pass(10);
  await scope.onmessage({ data: { id: 5, cancel: true } });
  await time.until(Promise.all([given, kept]));
  assert.ok("error" in replies(5)[1][0]);
  fileOf(6);
});

/** Video tracks of the group below. */
const TRACKS = 3;

test("video tracks are decoded in parallel; a failed decoder fails the file, and a dead one is not used again", async () => {
  const bytes = golden("golden/groups/0000.safetensors");
  host.answer(whole(bytes));
  const tracks = (id: number): FakeWorker[] =>
    FakeWorker.all.filter(({ posted }) =>
      posted.some((track) => track.samples && track.asked === undefined && ((track.asked = id), true)),
    );
  /** Wait until workers have received so many tracks; the codec is imported first, which takes an unknown time. */
  const started = async (count: number): Promise<void> => {
    const received = (): number =>
      FakeWorker.all.flatMap(({ posted }) => posted.filter(({ samples }) => samples)).length;
    for (let i = 0; i < 100_000 && received() < count; i++) await time.pass(0);
    assert.equal(received(), count);
  };
  const ended = ask(7, bytes);
  await started(TRACKS);
  const first = tracks(7);
  assert.equal(first.length, TRACKS, "each track has a worker of its own");
  for (const worker of first) worker.say({ error: "a picture is damaged" });
  await time.until(ended);
  assert.match((replies(7)[1][0] as { error: string }).error, /cannot be played: .*a picture is damaged/);
  const again = ask(8, bytes);
  await started(2 * TRACKS);
  assert.equal(FakeWorker.all.length, first.length, "those that failed serve again");
  for (const worker of FakeWorker.all) worker.die("out of memory");
  await time.until(again);
  assert.match((replies(8)[1][0] as { error: string }).error, /the video decoder failed \(out of memory\)/);
  assert.ok(first.every(({ terminated }) => terminated));
  void ask(9, bytes);
  await started(3 * TRACKS);
  assert.equal(FakeWorker.all.length, 2 * first.length);
});
