import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { pixelsOf } from "../packages/decoder/src/decode/paper";
import { parseHvcC } from "../packages/decoder/src/decode/hevc";
import { parseMp4 } from "../packages/decoder/src/decode/mp4";
import { parseContainer } from "../packages/decoder/src/reel/container";

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
