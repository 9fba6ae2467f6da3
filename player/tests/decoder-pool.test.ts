import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { PLAIN } from "@splatreel/decoder/base/errors";
import { DecoderPool } from "@splatreel/decoder/stream/decoder-pool";
import { decodeWorkers } from "../src/files/bundle";
import { FakeTime } from "./fakes/time";
import { FakeWorker, FILE } from "./fakes/workers";

const time = new FakeTime();
const source = (name: string, bytes = 1000) => ({ url: `https://page.example/${name}`, bytes, sha256: null });

let pool: DecoderPool;
let log: string[] = [];
/** Writes down what becomes of a file. */
const receiver = (name: string) => ({
  received: () => void log.push(`${name} received`),
  trouble: (why: string) => void log.push(`${name} trouble ${why}`),
  decoded: () => void log.push(`${name} done`),
  page: () => void log.push(`${name} done`),
  failed: (why: string, plain?: string) => void log.push(`${name} failed ${why} ${plain ?? ""}`),
});
const start = (name: string, points = 100): void => pool.start(name, source(name), points, receiver(name));
/** The worker that was last asked for a file, and the number of the request. */
const at = (name: string): { worker: FakeWorker; id: number } => {
  for (const worker of FakeWorker.all) {
    const request = worker.posted.findLast(({ source: of }) => of?.url.endsWith(`/${name}`));
    if (request) return { worker, id: request.id };
  }
  return assert.fail(`${name} was not asked for`);
};
const say = (name: string, what: object): void => at(name).worker.say({ id: at(name).id, ...what });

beforeEach(() => {
  FakeWorker.all.length = 0;
  log = [];
  pool = new DecoderPool(decodeWorkers);
  pool.onFree = () => void log.push("free");
});

test("the first worker starts at once, the second with the second file, and no third starts", () => {
  assert.deepEqual([FakeWorker.all.length, pool.free], [1, true]);
  start("a");
  assert.deepEqual([FakeWorker.all.length, pool.free], [1, true]);
  start("b");
  assert.deepEqual([FakeWorker.all.length, pool.free, pool.keys], [2, false, ["a", "b"]]);
  say("a", { file: FILE, milliseconds: 1 });
  assert.deepEqual(log, ["a done", "free"]);
  start("c");
  assert.deepEqual([FakeWorker.all.length, pool.free, pool.has("a"), pool.has("c")], [2, false, false, true]);
  assert.equal(at("c").worker, at("a").worker);
});

test("a worker that was started early is used first", () => {
  const early = new FakeWorker();
  const other = new DecoderPool(decodeWorkers, early as unknown as Worker);
  other.start("a", source("a"), 1, receiver("a"));
  assert.match(early.posted[0].files["hevc-worker.js"], /\/hevc-worker\.js$/);
  assert.equal(early.posted[1].source.url, source("a").url);
  other.destroy();
  assert.equal(early.terminated, true);
});

test("received bytes count over the time of their transfer", () => {
  start("a");
  assert.equal(pool.received("a"), 0);
  time.now += 500;
  say("a", { received: 200 });
  say("a", { received: 300 });
  time.now += 500;
  say("a", { received: 500 });
  assert.deepEqual([pool.received("a"), pool.meter.rate, log], [1000, 8000, ["a received", "a received", "a received"]]);
  time.now += 60_000; // decoding is no fault of the network
  say("a", { file: FILE, milliseconds: 1 });
  start("b");
  time.now += 1000;
  say("b", { received: 1000 });
  assert.equal(pool.meter.rate, 8000);
  assert.equal(pool.received("a"), 0, "it is not being got any more");
});

test("a file is almost complete if fewer bytes are missing than one round trip brings", () => {
  start("a");
  assert.equal(pool.isNearlyHere("a"), false);
  time.now += 100;
  say("a", { received: 100 });
  time.now += 100;
  say("a", { received: 300 });
  assert.equal(pool.isNearlyHere("a"), false, "600 are missing, and 400 come in the time of an answer");
  time.now += 1;
  say("a", { received: 300 });
  assert.equal(pool.isNearlyHere("a"), true);
  time.now += 10_000;
  assert.equal(pool.isNearlyHere("a"), false, "nothing came for long");
  say("a", { received: 300 });
  assert.equal(pool.isNearlyHere("a"), true, "all of it came");
  assert.equal(pool.isNearlyHere("b"), true, "nobody gets it");
  start("c");
  time.now += 100;
  say("c", { received: 500 });
  assert.equal(pool.isNearlyHere("c"), false, "how fast it comes is not known from the first bytes");
});

test("the decoding time per point follows the latest files", () => {
  for (const [name, milliseconds] of [["a", 100], ["b", 200]] as const) {
    start(name);
    say(name, { file: FILE, milliseconds });
  }
  assert.deepEqual([pool.milliseconds, pool.pace], [200, 1.3]);
  start("c", 0);
  say("c", { file: FILE, milliseconds: 7 });
  assert.deepEqual([pool.milliseconds, pool.pace], [7, 1.3], "a file without points says nothing");
});

test("trouble and failures reach the receiver, and the worker continues", () => {
  start("a");
  say("a", { trouble: "Trying again." });
  say("a", { error: "a is damaged.", plain: PLAIN.damaged });
  assert.deepEqual(log, ["a trouble Trying again.", `a failed a is damaged. ${PLAIN.damaged}`, "free"]);
  start("b");
  assert.equal(FakeWorker.all.length, 1);
});

test("a worker that dies fails only its own file, with a plain message", () => {
  start("a");
  start("b");
  at("a").worker.die();
  assert.deepEqual(log, [`a failed https://page.example/a cannot be decoded (its script cannot be loaded). ${PLAIN.player}`, "free"]);
  assert.deepEqual(pool.keys, ["b"]);
  log = [];
  start("c");
  at("c").worker.die("out of memory");
  assert.match(log[0], /c cannot be decoded \(out of memory\)/);
});

test("a worker that died is replaced", () => {
  start("a");
  start("b");
  const dead = at("a").worker;
  dead.die();
  assert.deepEqual([dead.terminated, pool.free, FakeWorker.all.length], [true, true, 2]);
  start("c");
  assert.deepEqual([at("c").worker === dead, FakeWorker.all.length, pool.free], [false, 3, false]);
  pool.cancel("c");
  at("c").worker.die();
  start("d");
  assert.deepEqual([FakeWorker.all.length, pool.free], [4, false]);
  say("b", { file: FILE, milliseconds: 1 });
  say("d", { file: FILE, milliseconds: 1 });
  assert.deepEqual(log.slice(-4), ["b done", "free", "d done", "free"]);
});

test("a page is requested as a page, and does not change the decoding rate", () => {
  pool.start("p", source("p"), null, receiver("p"));
  assert.equal(at("p").worker.posted.at(-1).page, true);
  say("p", { page: { groups: [] } });
  assert.deepEqual([log, pool.milliseconds, pool.pace], [["p done", "free"], 0, 0]);
});

test("a canceled file sends no more messages, and its worker is free after its answer", () => {
  start("a");
  start("b");
  const { worker, id } = at("a");
  pool.cancel("a");
  assert.deepEqual(worker.posted.at(-1), { id, cancel: true });
  assert.deepEqual([pool.has("a"), pool.free], [false, false]);
  worker.say({ id, received: 10 });
  assert.equal(pool.free, false);
  worker.say({ id, error: "it was given up" });
  assert.deepEqual([pool.free, log], [true, ["free"]]);
  start("c");
  worker.say({ id, file: FILE, milliseconds: 1 }); // late, and of another file
  assert.deepEqual([log, pool.has("c")], [["free"], true]);
  pool.cancel("nothing");
});

test("a worker that dies during a cancellation is replaced", () => {
  start("a");
  start("b");
  pool.cancel("a");
  at("a").worker.die();
  assert.deepEqual([pool.free, log], [true, ["free"]]);
});

test("closing ends all workers", () => {
  start("a");
  start("b");
  pool.destroy();
  assert.deepEqual(FakeWorker.all.map(({ terminated }) => terminated), [true, true]);
});
