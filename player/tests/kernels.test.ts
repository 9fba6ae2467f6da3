/** The kernels of WebAssembly against the plain ones: the same numbers, and the same errors. */
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { plain, type Kernels } from "../packages/decoder/src/decode/kernels";
import type { Form, Klt } from "../packages/decoder/src/decode/klt";
import { wasmKernels } from "../packages/decoder/src/decode/wasm";
import code from "../packages/decoder/wasm/kernels.wasm";

const fast = wasmKernels(new WebAssembly.Module(code));
const DATA = join(process.cwd(), "../tests/data");
const never = (): never => assert.fail("a predictive reel needs no other decoder");

let seed = 1;
const random = (below: number): number => (seed = (seed * 48271) % 2147483647) % below;

/** A stream of 18 contexts whose tables are all the same: 128 tokens, each as frequent as any other. bits: its plain bits. */
function encode(tokens: number[], bits: number): Uint8Array {
  const table: number[] = [];
  const gamma = (value: number): void => {
    const low = value.toString(2).length - 1;
    table.push(...new Array(low).fill(0), 1, ...Array.from({ length: low }, (_, i) => (value >> i) & 1));
  };
  for (let context = 0; context < 18; context++) {
    gamma(129);
    for (let token = 0; token < 128; token++) {
      gamma(token === 0 ? 13 : 1); // the first one's length is 6, zigzag 12; the others' as long
      table.push(0, 0, 0, 0, 0);
    }
  }
  let state = 65536;
  const words: number[] = [];
  for (const token of tokens.slice().reverse()) {
    if (state >= (65536 * 65536) / 128) {
      words.push(state & 65535);
      state >>>= 16;
    }
    state = ((Math.floor(state / 32) << 12) | (32 * token + (state % 32))) >>> 0;
  }
  const tables = Buffer.alloc(Math.ceil(table.length / 8));
  table.forEach((bit, i) => (tables[i >> 3] |= bit << (i & 7)));
  const head = Buffer.alloc(12);
  head[1] = 18;
  head.writeUInt16LE(tables.length, 2);
  head.writeUInt32LE(words.length, 4);
  head.writeUInt32LE(Math.ceil(bits / 8), 8);
  const tail = Buffer.alloc(4 + 2 * words.length);
  tail.writeUInt32LE(state, 0);
  words.reverse().forEach((word, i) => tail.writeUInt16LE(word, 4 + 2 * i));
  return new Uint8Array(
    Buffer.concat([head, tables, tail, Buffer.from(Array.from({ length: Math.ceil(bits / 8) }, () => random(256)))]),
  );
}

/** So many random numbers; those of two tokens have 4 or 5 plain bits more. */
function randomField(count: number): Uint8Array {
  const tokens = Array.from({ length: count }, () =>
    random(20) === 0 ? 32 + random(4) : random(random(3) === 0 ? 32 : 4),
  );
  return encode(
    tokens,
    tokens.reduce((sum, token) => sum + (token < 32 ? 0 : ((token - 32) >> 1) + 4), 0),
  );
}

function randomLattice(count: number): Float64Array {
  return Float64Array.from({ length: 3 * count }, (_, i) => Math.floor(i / 3) * 5 + random(30));
}

function randomKlt(count: number, dimensions: number, K: number, channels: number, some: number): Klt {
  const left = new Array(channels).fill(K);
  const columns = Uint8Array.from({ length: 1 + random(K * channels) }, () => {
    let channel = random(channels);
    while (left[channel] === 0) channel = (channel + 1) % channels;
    left[channel]--;
    return channel;
  });
  const ends = Int32Array.from({ length: count }, () => (random(100) < some ? random(columns.length + 1) : 0));
  return {
    data: randomField(ends.reduce((sum, end) => sum + end, 0)),
    ends,
    columns,
    channels,
    basis: Float64Array.from({ length: dimensions * K }, () => (random(2001) - 1000) / 777777),
    dimensions,
    levels: plain.levelsOf(randomLattice(count)),
    shifts: Uint8Array.from({ length: count }, () => random(8)),
  };
}

/** What both give, which must be the same; an error as its message. */
function both<T>(run: (kernels: Kernels) => T): T | string {
  const [first, second] = [plain, fast].map((kernels) => {
    try {
      return run(kernels);
    } catch (error) {
      assert.equal((error as Error).name, "ReelError", String((error as Error).stack));
      return (error as Error).message;
    }
  });
  assert.deepEqual(second, first);
  return first;
}

test("the kernels build levels and fields of random points as TypeScript does", () => {
  for (const count of [1, 2, 3, 127, 128, 129, 1000]) {
    const quantized = randomLattice(count);
    const levels = plain.levelsOf(quantized);
    assert.deepEqual(fast.levelsOf(quantized), levels);
    for (const columns of [1, 3]) {
      const data = randomField(count * columns);
      const shifts = Uint8Array.from({ length: count }, () => random(8));
      const found = both((kernels) => kernels.decodeLod(data, columns, levels, shifts));
      assert.ok(found instanceof Int32Array && new Set(found).size > (count > 100 ? 20 : 0), String(found));
    }
  }
});

test("coinciding points are handled", () => {
  const quantized = new Float64Array(3 * 500).fill(7);
  assert.deepEqual(fast.levelsOf(quantized), plain.levelsOf(quantized));
});

test("the kernels fill textures and rows from random coefficients", () => {
  const forms: [Form, number][] = [
    [{ turn: "nothing", rest: [0, 0, 0, 0], most: 65535 }, 3],
    [{ turn: "quaternion", rest: [1, 0, 0, 0], most: 255 }, 3],
    [{ turn: "color", rest: [0, 0, 0, 0], most: 255 }, 4],
  ];
  for (const [frames, K] of [
    [1, 1],
    [2, 2],
    [5, 3],
    [30, 17],
  ]) {
    for (const [form, channels] of forms) {
      for (const some of [0, 10, 100]) {
        const klt = randomKlt(300, frames, K, channels, some);
        const texture = both((kernels) => kernels.decodeTexture(klt, form));
        assert.ok(typeof texture !== "string" && texture.data.length === 4 * 300 * frames, String(texture));
        if (some === 100) assert.ok(new Set(texture.data).size > 20);
      }
    }
  }
  for (const size of [9, 24, 45]) {
    const klt = randomKlt(200, size, 7, 1, 50);
    assert.ok(both((kernels) => kernels.decodeRows(klt)) instanceof Float32Array);
  }
});

test("entropy-coded streams that are too short, too long or too large are rejected", () => {
  const levels = plain.levelsOf(randomLattice(200));
  const shifts = new Uint8Array(200);
  const run = (data: Uint8Array): unknown => both((kernels) => kernels.decodeLod(data, 1, levels, shifts));
  assert.match(run(randomField(150)) as string, /ends too early|damaged/);
  assert.match(run(randomField(250)) as string, /damaged/);
  const cut = encode(new Array(200).fill(40), 0); // plain bits that are not there
  assert.equal(run(cut), "a stream ends too early");
  assert.equal(run(encode(new Array(200).fill(127), 0)), "a stream holds numbers that are too large");
  const steep = encode([...new Array(199).fill(0), 80], 28);
  assert.ok(run(steep) instanceof Int32Array);
  shifts.fill(7);
  assert.equal(run(steep), "a section decodes to numbers that are too large");
});

test("golden files decode, and damaged ones are rejected", async () => {
  for (const folder of ["golden-predictive/layers", "golden-predictive/groups"]) {
    for (const name of readdirSync(join(DATA, folder))) {
      const whole = new Uint8Array(readFileSync(join(DATA, folder, name)));
      for (let run = 0; run < 24; run++) {
        const damaged = whole.slice();
        for (let i = 0; i < run % 4; i++) damaged[random(damaged.length)] = random(256);
        const [first, second] = await Promise.all(
          [plain, fast].map((kernels) => decodeFile(damaged, name, never, kernels).catch((error) => String(error))),
        );
        assert.deepEqual(second, first);
      }
    }
  }
});
