import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { deflateRawSync } from "node:zlib";
import { download } from "../packages/decoder/src/files/download";
import { LocalFiles } from "../packages/decoder/src/files/local-files";
import type { LocalFile, Source } from "../packages/decoder/src/files/source";
import { readManifest, sourceOf } from "../packages/decoder/src/reel/manifest";

const GOLDEN = join(process.cwd(), "../tests/data/golden");
const quiet = { received: () => undefined, trouble: () => undefined };

const plain = (bytes: Uint8Array | string): LocalFile => ({ blob: new Blob([bytes as BlobPart]), deflated: false });
const packed = (bytes: Uint8Array): LocalFile => ({
  blob: new Blob([deflateRawSync(bytes) as BlobPart]),
  deflated: true,
});
const golden = (pack: (bytes: Uint8Array) => LocalFile): LocalFiles =>
  new LocalFiles("golden", (uri) => pack(readFileSync(join(GOLDEN, uri))));
const read = (source: Source): Promise<Uint8Array> => download(source, quiet, new AbortController().signal);

test("a local reel is read like one on the network, packed or not", async () => {
  for (const pack of [plain, packed]) {
    const manifest = await readManifest(golden(pack));
    const file = manifest.groups[0];
    let received = 0;
    const bytes = await download(
      sourceOf(manifest, file),
      { ...quiet, received: (count) => (received += count) },
      new AbortController().signal,
    );
    assert.deepEqual(Buffer.from(bytes), readFileSync(join(GOLDEN, file.uri)));
    assert.equal(received, file.bytes);
  }
});

test("a missing, truncated, too long or changed file is reported at once", async () => {
  const bytes = new Uint8Array([1, 2, 3, 4]);
  const sha256 = "9f64a747e1b97f131fabb6b447296c9b6f0201e79fb3c5356e6c77e89b6a806a";
  const source = { url: "file:///x/a.bin", bytes: 4, sha256, part: plain(bytes) };
  assert.deepEqual(await read(source), bytes);
  const none = new LocalFiles("x", () => null);
  const cases: [Partial<Source>, RegExp][] = [
    [{ part: none.part("a.bin") }, /a\.bin cannot be read: it is missing/],
    [{ bytes: 5 }, /ends after 4 of 5 bytes/],
    [{ bytes: 3 }, /more than the 3 bytes/],
    [{ sha256: "0".repeat(64) }, /checksum/],
    [{ part: { blob: new Blob([bytes]), deflated: true } }, /cannot be read/],
  ];
  for (const [change, message] of cases)
    await assert.rejects(read({ ...source, ...change }), { name: "ReelError", message });
  await assert.rejects(readManifest(none), { name: "ReelError", message: /x is not a reel: it has no manifest\.json/ });
});

test("a file that inflates far beyond the manifest's size is rejected early", async () => {
  const bomb = deflateRawSync(Buffer.alloc(64 << 20));
  let received = 0;
  const source = {
    url: "file:///x/a.bin",
    bytes: 1000,
    sha256: null,
    part: { blob: new Blob([bomb as BlobPart]), deflated: true },
  };
  await assert.rejects(
    download(source, { ...quiet, received: (count) => (received += count) }, new AbortController().signal),
    /more than the 1000 bytes/,
  );
  assert.ok(received <= 1000);
  const packed = new LocalFiles("x", () => ({ blob: new Blob([bomb as BlobPart]), deflated: true }));
  await assert.rejects(packed.manifest(), { name: "ReelError", message: /longer than 16777216 bytes/ });
});
