import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { beforeEach, test } from "node:test";
import { PLAIN, ReelError } from "../packages/decoder/src/base/errors";
import { download, downloadText } from "../packages/decoder/src/files/download";
import { FakeHost, pieces, ranged, status, unreachable, whole } from "./fakes/host";
import { device, page } from "./fakes/page";
import { FakeTime } from "./fakes/time";
import { isIntact } from "../packages/decoder/src/files/checksum";
import { sha256 } from "../packages/decoder/src/files/sha256";

const URL = "https://page.example/reel/groups/0000.safetensors";
const BODY = Uint8Array.from({ length: 1000 }, (_, i) => (7 * i) % 251);
const source = { url: URL, bytes: BODY.length, sha256: createHash("sha256").update(BODY).digest("hex") };
const time = new FakeTime();
const host = new FakeHost();

let received = 0;
let troubles: string[] = [];
let life = new AbortController();
const watcher = {
  received: (bytes: number) => void (received += bytes),
  trouble: (why: string) => void troubles.push(why),
};
const get = (of = source): Promise<Uint8Array> => time.until(download(of, watcher, life.signal));
/** Seconds between the requests. */
const waits = (): number[] => host.asked.slice(1).map(({ at }, i) => (at - host.asked[i].at) / 1000);

beforeEach(() => {
  [received, troubles, life, device.onLine] = [0, [], new AbortController(), true];
});

test("a file downloads at once, and its bytes are reported on arrival", async () => {
  host.answer(pieces([BODY.slice(0, 300), BODY.slice(300)], "over"));
  assert.deepEqual(await get(), BODY);
  assert.deepEqual(
    [received, troubles, host.asked.length, host.asked[0].range, host.asked[0].cache],
    [1000, [], 1, null, "default"],
  );
});

test("a failing host is retried with growing waits, without the browser's cache", async () => {
  host.answer(status(503), status(429), unreachable, whole(BODY));
  assert.deepEqual(await get(), BODY);
  for (const [i, least] of [0.3, 1, 2].entries())
    assert.ok(waits()[i] >= least && waits()[i] <= 1.5 * least + 0.01, `${waits()}`);
  assert.deepEqual(
    host.asked.map(({ cache }) => cache),
    ["default", "reload", "reload", "reload"],
  );
  assert.match(troubles[0], /^Retrying: it answered 503/);
  assert.match(troubles[2], /Failed to fetch.*Check the address/);
});

test("an interrupted transfer continues at its offset", async () => {
  host.answer(pieces([BODY.slice(0, 400)], "broken"), pieces([BODY.slice(400, 900)], "over", 206), ranged(BODY));
  assert.deepEqual(await get(), BODY);
  assert.deepEqual(
    host.asked.map(({ range }) => range),
    [null, "bytes=400-", "bytes=900-"],
  );
  assert.equal(received, 1000);
  assert.match(troubles[1], /ended after 900 of 1000 bytes/);
});

test("a host without range requests starts over", async () => {
  host.answer(pieces([BODY.slice(0, 400)], "broken"), whole(BODY), whole(BODY));
  assert.deepEqual(await get(), BODY);
  assert.equal(host.asked.length, 2);
  host.answer(pieces([BODY.slice(0, 400)], "broken"), status(416), ranged(BODY));
  assert.deepEqual(await get(), BODY);
  assert.deepEqual(
    host.asked.map(({ range }) => range),
    [null, "bytes=400-", null],
  );
});

test("a stalled transfer is aborted after eight seconds, a slow one is not", async () => {
  host.answer(pieces([BODY.slice(0, 10)], "silent"), ranged(BODY));
  assert.deepEqual(await get(), BODY);
  assert.ok(waits()[0] >= 8.3 && waits()[0] <= 8.5, `${waits()}`);
  assert.match(troubles[0], /no data arrived/);
  const piecesOf = (body: Uint8Array): Uint8Array[] =>
    [...Array(10).keys()].map((i) => body.slice(100 * i, 100 * i + 100));
  host.answer(pieces(piecesOf(BODY), "over", 200, 7000));
  troubles = [];
  assert.deepEqual(await get(), BODY);
  host.answer(pieces(piecesOf(BODY.map((byte) => byte & 127)), "over", 200, 7000));
  assert.equal((await time.until(downloadText(URL, watcher, life.signal))).length, BODY.length);
  assert.deepEqual([host.asked.length, troubles], [1, []]);
});

test("a file fails after five retries, and viewers see that the network is the cause", async () => {
  host.answer(status(500));
  await assert.rejects(
    get(),
    (error: ReelError) =>
      error instanceof ReelError &&
      error.plain === PLAIN.network &&
      error.message.startsWith(`${URL} cannot be downloaded: it answered 500`),
  );
  assert.equal(host.asked.length, 6);
  assert.equal(time.pending, 0);
});

test("permanent failures are not retried", async () => {
  for (const [code, plain] of [
    [404, PLAIN.missing],
    [410, PLAIN.missing],
    [401, PLAIN.refused],
    [403, PLAIN.refused],
  ] as const) {
    host.answer(status(code));
    await assert.rejects(get(), { name: "ReelError", plain });
    assert.equal(host.asked.length, 1);
  }
});

test("a file that differs from the manifest is requested twice more, from its beginning", async () => {
  const other = BODY.map((byte) => byte ^ 1);
  for (const [wrong, message] of [
    [[other], /checksum/],
    [[BODY, BODY.slice(0, 1)], /more than the 1000 bytes/],
  ] as const) {
    host.answer(pieces([...wrong], "over"));
    await assert.rejects(get(), { name: "ReelError", message, plain: PLAIN.damaged });
    assert.deepEqual(
      host.asked.map(({ range }) => range),
      [null, null, null],
    );
  }
  host.answer(whole(other), whole(BODY));
  assert.deepEqual(await get(), BODY);
});

test("a manifest that is too long or is not UTF-8 is refused", async () => {
  host.answer(whole(Uint8Array.of(0x7b, 0xe9, 0x7d)));
  await assert.rejects(time.until(downloadText(URL, watcher, life.signal)), {
    name: "ReelError",
    message: /not UTF-8/,
  });
  host.answer(whole(new Uint8Array((16 << 20) + 1)));
  await assert.rejects(time.until(downloadText(URL, watcher, life.signal)), {
    name: "ReelError",
    message: /longer than/,
  });
});

test("a cancellation ends a transfer or a wait at once", async () => {
  for (const answer of [pieces([BODY.slice(0, 10)], "silent"), status(503)]) {
    host.answer(answer);
    const promise = download(source, watcher, life.signal);
    await time.pass(100);
    life.abort();
    await assert.rejects(promise);
    await time.pass(60_000);
    assert.deepEqual([host.asked.length, time.pending], [1, 0]);
    life = new AbortController();
  }
  life.abort();
  host.answer(whole(BODY));
  await assert.rejects(download(source, watcher, life.signal), { name: "AbortError" });
  assert.equal(host.asked.length, 0);
});

test("nothing fails while offline, and downloads continue once online", async () => {
  device.onLine = false;
  host.answer(unreachable);
  const promise = download(source, watcher, life.signal);
  await time.pass(600_000);
  assert.deepEqual([...new Set(troubles)], ["Offline. Waiting for the network."]);
  assert.ok(host.asked.length > 20);
  device.onLine = true;
  host.answer(whole(BODY));
  await time.pass(1); // the pause that it is in is not over
  assert.equal(host.asked.length, 0);
  page.dispatchEvent(new Event("online"));
  assert.deepEqual(await promise, BODY);
});

test("a host that rejects this page is told apart from one that does not answer", async () => {
  const other = { ...source, url: "https://other.example/a.bin" };
  host.answer((options) => (options.mode === "no-cors" ? new Response() : unreachable(options)));
  await assert.rejects(get(other), {
    name: "ReelError",
    plain: PLAIN.refused,
    message: /pages of https:\/\/page\.example read it.*Access-Control-Allow-Origin/,
  });
  assert.deepEqual(
    host.asked.map(({ mode }) => mode),
    [undefined, "no-cors"],
  );
  host.answer(unreachable);
  await assert.rejects(get(other), { name: "ReelError", plain: PLAIN.network });
  host.answer(unreachable);
  await assert.rejects(get(), { plain: PLAIN.network });
  assert.ok(
    host.asked.every(({ mode }) => mode === undefined),
    "the page's own host hides nothing",
  );
});

test("a manifest is never cached, is retried twice at most, and may arrive in pieces", async () => {
  const bytes = new TextEncoder().encode("größer");
  host.answer(status(503), pieces([bytes.slice(0, 3), bytes.slice(3)], "over"));
  assert.equal(await time.until(downloadText(URL, watcher, life.signal)), "größer");
  assert.deepEqual(
    host.asked.map(({ cache }) => cache),
    ["no-cache", "no-cache"],
  );
  host.answer(status(503));
  await assert.rejects(time.until(downloadText(URL, watcher, life.signal)), { name: "ReelError" });
  assert.equal(host.asked.length, 3);
});

test("a page adds headers, cookies or another address to each request of a private file", async () => {
  const access = {
    credentials: "include",
    request: async (url: string) => ({
      url: `${url}?signed`,
      headers: new Headers({ Authorization: `Bearer ${host.asked.length}` }),
    }),
  } as const;
  const other = { ...source, access };
  host.answer(pieces([BODY.slice(0, 400)], "broken"), ranged(BODY));
  assert.deepEqual(await time.until(download(other, watcher, life.signal)), BODY);
  assert.deepEqual(
    host.asked.map(({ url, range, authorization, credentials }) => [url, range, authorization, credentials]),
    [
      [`${URL}?signed`, null, "Bearer 0", "include"],
      [`${URL}?signed`, "bytes=400-", "Bearer 1", "include"],
    ],
  );
  host.answer(whole("{}"));
  await time.until(downloadText(URL, watcher, life.signal, access));
  assert.deepEqual([host.asked[0].authorization, host.asked[0].credentials], ["Bearer 0", "include"]);
  const failing = { request: () => Promise.reject(new Error("no token")) };
  await assert.rejects(time.until(downloadText(URL, watcher, life.signal, failing)), {
    name: "ReelError",
    plain: PLAIN.refused,
    message: /0000\.safetensors cannot be requested: no token/,
  });
  host.answer((options) => (options.mode === "no-cors" ? new Response() : unreachable(options)));
  await assert.rejects(
    time.until(downloadText("https://other.example/manifest.json", watcher, life.signal, access)),
    /Allow-Credentials: true and Access-Control-Allow-Headers: authorization/,
  );
});

const bytesOf = (length: number): Uint8Array => Uint8Array.from({ length }, (_, i) => (i * 7919 + (i >> 3)) & 255);

test("the digest of messages of every length around a block is that of Node", () => {
  for (const length of [...Array(200).keys(), 65_535, 1_000_003]) {
    const bytes = bytesOf(length);
    assert.equal(sha256(bytes), createHash("sha256").update(bytes).digest("hex"), `${length} bytes`);
    assert.equal(
      sha256(bytesOf(length + 5).subarray(5)),
      createHash("sha256")
        .update(bytesOf(length + 5).subarray(5))
        .digest("hex"),
    );
  }
});

test("files are compared with their digest where crypto.subtle is missing, as on plain http", async () => {
  const bytes = bytesOf(1000);
  const digest = createHash("sha256").update(bytes).digest("hex");
  const known = Object.getOwnPropertyDescriptor(globalThis, "crypto")!;
  for (const crypto of [globalThis.crypto, {}, undefined]) {
    Object.defineProperty(globalThis, "crypto", { value: crypto, configurable: true });
    try {
      assert.deepEqual([await isIntact(bytes, digest), await isIntact(bytes.with(3, 9), digest)], [true, false]);
    } finally {
      Object.defineProperty(globalThis, "crypto", known);
    }
  }
});
