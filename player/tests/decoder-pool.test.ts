import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { PLAIN } from "../packages/decoder/src/base/errors";
import type { DecodeReply } from "../packages/decoder/src/decode/decode-worker";
import { BandwidthMeter, DecoderPool, EARLY } from "../packages/decoder/src/stream/decoder-pool";
import { decodeWorkers } from "../packages/renderer/src/files/bundle";
import { FakeTime } from "./fakes/time";
import { FakeWorker, FILE } from "./fakes/workers";

const time = new FakeTime();
const source = (name: string, bytes = 1000) => ({ url: `https://page.example/${name}`, bytes, sha256: "0".repeat(64) });

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
  const other = new DecoderPool(decodeWorkers, { worker: early as unknown as Worker, file: null });
  other.start("a", source("a"), 1, receiver("a"));
  assert.match(early.posted[0].files["hevc-worker.js"], /\/hevc-worker\.js$/);
  assert.equal(early.posted[1].source.url, source("a").url);
  other.destroy();
  assert.equal(early.terminated, true);
});

test("a file that the page requested early is taken over, with the replies so far and their times", async () => {
  const worker = new FakeWorker();
  const early = {
    worker: worker as unknown as Worker,
    file: { url: source("a").url, replies: [] as { data: DecodeReply; at: number }[] },
  };
  early.file.replies.push(
    { data: { id: EARLY, received: 400 }, at: time.now - 500 },
    { data: { id: EARLY, received: 100 }, at: time.now - 400 },
  );
  const other = new DecoderPool(decodeWorkers, early);
  other.start("a", source("a"), 1, receiver("a"));
  assert.deepEqual(
    [worker.posted.filter((request) => "source" in request), log],
    [[], []],
    "nothing is requested again",
  );
  await Promise.resolve();
  assert.deepEqual([other.received("a"), log, other.meter.rate], [500, ["a received", "a received"], 0]);
  assert.equal(other.isNearlyHere("a"), false, "the round trip is unknown");
  other.start("b", source("b"), 1, receiver("b"));
  assert.notEqual(at("b").worker, worker);
  worker.say({ id: EARLY, received: 500 });
  worker.say({ id: EARLY, file: FILE, milliseconds: 1 });
  assert.deepEqual([log.slice(2), other.keys], [["a received", "a done"], ["b"]]);
  other.start("c", source("c"), 1, receiver("c"));
  assert.equal(at("c").worker, worker);
  other.destroy();
});

test("an early file waits while other files load, and is canceled if they need its worker", async () => {
  const early = () => ({
    worker: new FakeWorker() as unknown as Worker,
    file: { url: source("a").url, replies: [{ data: { id: EARLY, received: 400 } as DecodeReply, at: time.now }] },
  });
  const [one, other] = [early(), early()];
  const patient = new DecoderPool(decodeWorkers, one);
  patient.start("b", source("b"), 1, receiver("b"));
  assert.notEqual(at("b").worker as unknown, one.worker);
  patient.start("a", source("a"), 1, receiver("a"));
  await Promise.resolve();
  assert.deepEqual([log, patient.free], [["a received"], false]);
  patient.destroy();
  log = [];
  const busy = new DecoderPool(decodeWorkers, other);
  for (const name of ["c", "d"]) busy.start(name, source(name), 1, receiver(name));
  const { posted } = other.worker as unknown as FakeWorker;
  assert.deepEqual(
    posted.slice(1).map(({ id, cancel = false }) => [id, cancel]),
    [
      [EARLY, true],
      [1, false],
    ],
  );
  (other.worker as unknown as FakeWorker).say({ id: EARLY, error: "canceled" });
  assert.deepEqual([log, busy.keys], [[], ["c", "d"]]);
  say("d", { file: FILE, milliseconds: 1 });
  busy.start("a", source("a"), 1, receiver("a"));
  assert.equal(at("a").id, 2, "it is requested again");
  busy.destroy();
});

test("an early file that is canceled after it was taken over is not delivered", async () => {
  const worker = new FakeWorker();
  const replies = [{ data: { id: EARLY, file: FILE, milliseconds: 1 } as unknown as DecodeReply, at: time.now }];
  const other = new DecoderPool(decodeWorkers, {
    worker: worker as unknown as Worker,
    file: { url: source("a").url, replies },
  });
  other.start("a", source("a"), 1, receiver("a"));
  other.cancel("a");
  await Promise.resolve();
  assert.deepEqual([log, other.keys], [[], []]);
  for (const name of ["b", "c"]) other.start(name, source(name), 1, receiver(name));
  assert.ok([at("b").worker, at("c").worker].includes(worker), "the worker is idle");
  other.destroy();
});

test("received bytes count over the time of their transfer", () => {
  start("a");
  assert.equal(pool.received("a"), 0);
  time.now += 500;
  say("a", { received: 200 });
  say("a", { received: 300 });
  time.now += 500;
  say("a", { received: 500 });
  assert.deepEqual(
    [pool.received("a"), pool.meter.rate, log],
    [1000, 8000, ["a received", "a received", "a received"]],
  );
  time.now += 60_000; // decoding is not a fault of the network
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
  for (const [name, milliseconds] of [
    ["a", 100],
    ["b", 200],
  ] as const) {
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
  assert.deepEqual(log, [
    `a failed https://page.example/a cannot be decoded (its script cannot be loaded). ${PLAIN.player}`,
    "free",
  ]);
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
  assert.deepEqual(
    FakeWorker.all.map(({ terminated }) => terminated),
    [true, true],
  );
});

test("the page prepares the request of a private file, and the worker sends it", async () => {
  const ready: ((token: string) => void)[] = [];
  const request = () =>
    new Promise<{ headers: HeadersInit }>((resolve) =>
      ready.push((token) => resolve({ headers: { Authorization: token } })),
    );
  const ask = (name: string): void => pool.start(name, { ...source(name), access: { request } }, 100, receiver(name));
  const posted = (): unknown[] => FakeWorker.all.flatMap((worker) => worker.posted.slice(1));
  ask("a");
  ask("b");
  pool.cancel("b"); // before it was requested
  await new Promise(setImmediate);
  assert.deepEqual([log, pool.keys, pool.free, posted()], [["free"], ["a"], true, []]);
  ready.forEach((answer) => answer("token"));
  await new Promise(setImmediate);
  assert.deepEqual(
    posted().map((message) => (message as { source: { request: unknown; access?: unknown } }).source),
    [{ ...source("a"), request: { credentials: undefined, headers: { authorization: "token" } } }],
  );
  say("a", { file: FILE, milliseconds: 1 });
  pool.start(
    "c",
    { ...source("c"), access: { request: () => Promise.reject(new Error("no token")) } },
    1,
    receiver("c"),
  );
  await new Promise(setImmediate);
  assert.deepEqual(log.slice(1, 3), ["a done", "free"]);
  assert.match(log[3], /^c failed .*c cannot be requested: no token/);
  assert.deepEqual([pool.keys, pool.free], [[], true]);
});

const near = (value: number, expected: number): void =>
  assert.ok(Math.abs(value / expected - 1) < 0.01, `${value} is not ${expected}`);

test("the rate is 0 before the first transfer", () => assert.equal(new BandwidthMeter().rate, 0));

test("concurrent transfers share the bandwidth", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.begin(0);
  for (let now = 100; now <= 1000; now += 100) {
    meter.addBytes(25_000, now);
    meter.addBytes(25_000, now);
  }
  near(meter.rate, 4e6);
});

test("idle time does not count; waiting for the first byte does", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.addBytes(50_000, 400);
  meter.end(400);
  meter.begin(5000);
  meter.addBytes(50_000, 5400);
  near(meter.rate, 1e6);
});

test("old transfers are forgotten", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  let now = 0;
  for (let i = 0; i < 20; i++) meter.addBytes(125_000, (now += 1000));
  near(meter.rate, 1e6);
  for (let i = 0; i < 5; i++) meter.addBytes(125_000, (now += 100));
  near(meter.rate, 1e7);
});

test("the estimate rises while the line is idle", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.addBytes(125_000, 1000);
  meter.end(1000);
  near(meter.optimisticRate(1000), 1e6);
  near(meter.optimisticRate(11_000), 4e6);
  meter.begin(20_000);
  assert.equal(meter.optimisticRate(21_000), meter.rate);
  meter.addBytes(125_000, 20_100);
  near(meter.rate, 1e7);
});
