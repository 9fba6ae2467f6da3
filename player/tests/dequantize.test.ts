import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { flags, inflate, linear, packedSize, unpack } from "../packages/decoder/src/decode/dequantize";
import { half } from "../packages/renderer/src/draw/point-words";
import type { Container } from "../packages/decoder/src/reel/container";

/** The low bytes of all, then the bits above, lowest bit first. */
function pack(values: number[], bits: number): Uint8Array {
  const low = bits > 8 ? values.map((value) => value & 255) : [];
  const rest = bits > 8 ? values.map((value) => value >> 8) : values;
  const width = bits > 8 ? bits - 8 : bits;
  const high = new Uint8Array(Math.ceil((values.length * width) / 8));
  rest.forEach((value, i) => {
    for (let b = 0; b < width; b++) high[(i * width + b) >> 3] |= ((value >> b) & 1) << ((i * width + b) & 7);
  });
  return Uint8Array.from([...low, ...high]);
}

function container(name: string, parameters: object, data: Uint8Array): Container {
  return {
    kind: "layer",
    index: 0,
    points: 0,
    firstFrame: 0,
    frames: 0,
    sections: { [name]: parameters as never },
    data: { [name]: data },
  };
}

test("unpacks every width", () => {
  for (let bits = 1; bits <= 16; bits++) {
    const values = Array.from({ length: 37 }, (_, i) => (i * 40503 + 7) % 2 ** bits);
    const data = pack(values, bits);
    assert.equal(data.length, packedSize(values.length, bits));
    assert.deepEqual([...unpack(data, bits, values.length)], values);
  }
});

test("inflates zlib and rejects another size", async () => {
  const plain = Uint8Array.from({ length: 100 }, (_, i) => i % 7);
  assert.deepEqual(await inflate(new Uint8Array(deflateSync(plain)), true, 100), plain);
  await assert.rejects(inflate(plain, false, 99), /100 bytes, expected 99/);
});

test("linear values are stored by column, over the range of each column", async () => {
  const file = container(
    "scales",
    { codec: "linear", bits: 8, min: [0, -1], max: [51, 1] },
    Uint8Array.from([0, 5, 255, 0, 255, 0]),
  );
  assert.deepEqual([...(await linear(file, "scales", 3, 2))], [0, -1, 1, 1, 51, -1]);
});

test("log values are powers of two", async () => {
  const file = container(
    "scales",
    { codec: "linear", bits: 8, min: [-10], max: [0], log: true },
    Uint8Array.from([0, 255]),
  );
  assert.deepEqual([...(await linear(file, "scales", 2, 1))], [2 ** -10, 1]);
});

test("flags are single bits, and an unknown codec is named", async () => {
  const file = container("alive", { codec: "bits", count: 10 }, Uint8Array.from([0b101, 0b10]));
  assert.deepEqual([...(await flags(file, "alive"))], [1, 0, 1, 0, 0, 0, 0, 0, 0, 1]);
  await assert.rejects(flags(container("alive", { codec: "rle" }, new Uint8Array(2)), "alive"), /codec "rle"/);
});

test("half precision is decoded", () => {
  const known: [number, number][] = [
    [0, 0],
    [1, 0x3c00],
    [-2, 0xc000],
    [65504, 0x7bff],
    [1e6, 0x7bff],
    [2 ** -24, 1],
    [2 ** -14, 0x400],
    [0.333251953125, 0x3555],
  ];
  for (const [value, bits] of known) assert.equal(half(value), bits, String(value));
});
