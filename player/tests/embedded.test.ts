import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { loadPart } from "../packages/renderer/src/files/bundle";
import { download } from "../packages/decoder/src/files/download";
import { embeddedPlayerFile, embeddedReel } from "../packages/renderer/src/files/embedded";
import { addressOf, readManifest, sourceOf } from "../packages/decoder/src/reel/manifest";
import "./fakes/page";

const GOLDEN = join(process.cwd(), "../tests/data/golden-predictive");
const manifest = readFileSync(join(GOLDEN, "manifest.json"), "utf8");
const quiet = { received: () => undefined, trouble: () => undefined };

/** The page's elements, by their selectors; their text has line breaks around it, as in a file. */
function contain(files: Record<string, Uint8Array>): void {
  const find = (selector: string): object | null => {
    const name = Object.keys(files).find((file) => selector === `script[${file}]`);
    return name ? { textContent: `\n${Buffer.from(files[name]).toString("base64")}\n` } : null;
  };
  Object.assign(document, {
    querySelector: find,
    getElementById: (id: string) => (id === "splatreel-manifest" ? { textContent: manifest } : null),
  });
}

test("a reel inside the page is read from it, and checked like any other", async () => {
  const uri = JSON.parse(manifest).layers[0].uri as string;
  const bytes = new Uint8Array(readFileSync(join(GOLDEN, uri)));
  contain({ [`data-reel-file="${uri}"`]: bytes });
  const found = await readManifest(embeddedReel());
  assert.deepEqual(await download(sourceOf(found, found.layers[0]), quiet, new AbortController().signal), bytes);
  await assert.rejects(download(sourceOf(found, found.groups[0]), quiet, new AbortController().signal), {
    name: "ReelError",
    message: /it is missing/,
  });
  contain({ [`data-reel-file="${uri}"`]: bytes.with(9, bytes[9] ^ 1) });
  await assert.rejects(download(sourceOf(found, found.layers[0]), quiet, new AbortController().signal), {
    name: "ReelError",
    message: /checksum/,
  });
});

test("files of the player inside the page replace those beside it", async () => {
  contain({
    'data-player-file="share.js"': Buffer.from("export const here = 1;"),
    'data-player-file="a.wasm"': Uint8Array.of(0, 1),
  });
  assert.equal(embeddedPlayerFile("share.js")!.type, "text/javascript");
  assert.deepEqual([embeddedPlayerFile("a.wasm")!.type, embeddedPlayerFile("a.wasm")!.size], ["application/wasm", 2]);
  assert.equal(embeddedPlayerFile("other.js"), null);
  const made: Blob[] = [];
  const { createObjectURL } = URL;
  URL.createObjectURL = (blob) => (made.push(blob as Blob), "data:text/javascript,export const here = 1;");
  assert.equal((await loadPart("share.js", () => Promise.reject(new Error("it is in the page")))).here, 1);
  URL.createObjectURL = createObjectURL;
  assert.equal(await made[0].text(), "export const here = 1;");
  assert.equal(await loadPart("other.js", () => Promise.resolve("beside")), "beside");
});

test("an image of a local reel has one address until the reel is closed", async () => {
  contain({ 'data-reel-file="poster.jpg"': Uint8Array.of(1, 2, 3) });
  const found = await readManifest(embeddedReel());
  const picture = { uri: "poster.jpg", bytes: 3, sha256: "0".repeat(64) };
  const address = await addressOf(found, picture);
  assert.match(address, /^blob:/);
  assert.equal(await addressOf(found, picture), address);
  const revoked: string[] = [];
  URL.revokeObjectURL = (url) => void revoked.push(url);
  found.files!.close();
  await Promise.resolve();
  assert.deepEqual(revoked, [address]);
  assert.notEqual(await addressOf(found, picture), address);
});
