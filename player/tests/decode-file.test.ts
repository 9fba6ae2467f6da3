import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { decodePaper, pixelsOf } from "../packages/decoder/src/decode/paper";
import { mortonOrder } from "../packages/decoder/src/decode/gaussians";
import { parseHvcC } from "../packages/decoder/src/decode/hevc";
import { parseMp4 } from "../packages/decoder/src/decode/mp4";
import { parseContainer } from "../packages/decoder/src/reel/container";

const golden = new URL("../tests/data/golden/groups/0000.safetensors", `file://${process.cwd()}/`);

/** The golden group, its metadata changed by the same number of bytes. */
function forged(from: string, to: string): Uint8Array {
  const text = readFileSync(golden).toString("latin1");
  assert.ok(text.includes(from) && from.length === to.length, from);
  return new Uint8Array(Buffer.from(text.replace(from, to), "latin1"));
}

const never = (): never => assert.fail("nothing may be decoded");

test("a motion codec of the paper's tables is rejected by name", async () => {
  const file = forged('\\"codec\\":\\"h265\\",', '\\"codec\\":\\"ori\\" ,');
  await assert.rejects(
    decodeFile(file, "groups/0000.safetensors", (paper, kernels) => decodePaper(paper, never, never, kernels)),
    (error: Error) => {
      assert.match(
        error.message,
        /^groups\/0000.safetensors cannot be played: its motion has the codec ori, and this player knows h265/,
      );
      return true;
    },
  );
});

function code(x: number, y: number, z: number): bigint {
  let result = 0n;
  for (let b = 0; b < 21; b++) {
    [x, y, z].forEach((v, a) => (result |= BigInt((v >> b) & 1) << BigInt(3 * b + a)));
  }
  return result;
}

test("sorts by Morton code over all 21 bits", () => {
  const random = lcg(7);
  const q = Array.from({ length: 3 * 500 }, () => Math.floor(random() * 2 ** 21));
  const codes = Array.from(mortonOrder(q), (i) => code(q[3 * i], q[3 * i + 1], q[3 * i + 2]));
  assert.ok(codes.every((value, i) => i === 0 || codes[i - 1] <= value));
  assert.equal(new Set(mortonOrder(q)).size, 500);
});

test("keeps equal points in their order", () => {
  assert.deepEqual([...mortonOrder([5, 5, 5, 0, 0, 0, 5, 5, 5])], [1, 0, 2]);
});

function lcg(seed: number): () => number {
  return () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32;
}

const bytes = new Uint8Array(readFileSync("../tests/data/golden/groups/0000.safetensors"));
const video = parseContainer(bytes, "golden").data.offsets;

test("finds the three tracks and their decoder settings", () => {
  const tracks = parseMp4(video, 100);
  assert.deepEqual(
    tracks.map((track) => track.name),
    ["hi", "lo", "rot"],
  );
  assert.deepEqual(
    tracks.map((track) => track.samples.length),
    [8, 8, 8],
  );
  for (const track of tracks) {
    const { codec, lengthSize, parameterSets } = parseHvcC(track.hvcC);
    assert.match(codec, /^hvc1\.1\.[0-9a-f]+\.L\d+(\.[0-9A-F]+)*$/);
    assert.equal(lengthSize, 4);
    assert.ok(["32", "33", "34"].every((kind) => parameterSets.some((set) => String((set[0] >> 1) & 63) === kind)));
  }
});

test("a truncated video is rejected", () => {
  for (const size of [0, 40, 1000, video.length - 1])
    assert.throws(() => parseMp4(video.slice(0, size), 100), { name: "ReelError" });
});

test("a truncated file is rejected by name", () => {
  for (const size of [0, 7, 100, bytes.length - 1])
    assert.throws(() => parseContainer(bytes.slice(0, size), "g.safetensors"), /g\.safetensors is damaged/);
});

test("points run through blocks in Z-order, and blocks back and forth", () => {
  const pixels = pixelsOf(4 * 256, 32);
  assert.deepEqual([...pixels.slice(0, 5)], [0, 1, 32, 33, 2]);
  assert.equal(pixels[256], 16);
  assert.equal(pixels[512], 16 * 32 + 16);
  assert.equal(pixels[768], 16 * 32);
  assert.equal(new Set(pixels).size, 1024);
});
