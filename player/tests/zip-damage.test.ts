/** Zips that were damaged at random, the same in every run: each gives its files, or an error in words. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateRawSync } from "node:zlib";
import { ReelError } from "../packages/decoder/src/base/errors";
import { filesOfZip } from "../packages/element/src/files/zip";

/** A zip of deflated files. */
function zip(files: Record<string, Buffer>): Buffer {
  const [bodies, directory] = [[] as Buffer[], [] as Buffer[]];
  let offset = 0;
  for (const [name, bytes] of Object.entries(files)) {
    const packed = deflateRawSync(bytes);
    const shared = Buffer.alloc(26);
    shared.writeUInt16LE(20, 0);
    shared.writeUInt16LE(8, 4);
    shared.writeUInt32LE(packed.length, 14);
    shared.writeUInt32LE(bytes.length, 18);
    shared.writeUInt16LE(name.length, 22);
    const rest = Buffer.alloc(14);
    rest.writeUInt32LE(offset, 10);
    directory.push(Buffer.concat([Buffer.from("PK\x01\x02\x14\x00", "latin1"), shared, rest, Buffer.from(name)]));
    bodies.push(Buffer.concat([Buffer.from("PK\x03\x04", "latin1"), shared, Buffer.from(name), packed]));
    offset += bodies.at(-1)!.length;
  }
  const listed = Buffer.concat(directory);
  const end = Buffer.alloc(22);
  end.write("PK\x05\x06", "latin1");
  for (const at of [8, 10]) end.writeUInt16LE(bodies.length, at);
  end.writeUInt32LE(listed.length, 12);
  end.writeUInt32LE(offset, 16);
  return Buffer.concat([...bodies, listed, end]);
}

let state = 7;
const random = (below: number): number => {
  state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
  return Math.floor((state / 2 ** 32) * below);
};
const GOOD = zip({
  "manifest.json": Buffer.from("{}"),
  "groups/0.bin": Buffer.alloc(500, "group"),
  "layers/0.bin": Buffer.from([...Array(200).keys()]),
});

/** Change bytes, most of them in the directory and at the end; cut off; or put bytes between. */
function damaged(): Buffer {
  const act = random(8);
  if (act === 0) return GOOD.subarray(0, random(GOOD.length));
  if (act === 1)
    return Buffer.concat([
      GOOD.subarray(0, random(GOOD.length)),
      Buffer.alloc(1 + random(40), random(256)),
      GOOD.subarray(random(GOOD.length)),
    ]);
  const bytes = Buffer.from(GOOD);
  const first = act < 5 ? GOOD.indexOf("PK\x01\x02", 0, "latin1") : 0;
  for (let times = 1 + random(4); times > 0; times--)
    bytes[first + random(GOOD.length - first)] = [0, 1, 255, random(256)][random(4)];
  return bytes;
}

test("a damaged zip yields files within its bounds, or a ReelError that names it", async () => {
  let [read, refused] = [0, 0];
  for (let i = 0; i < 1000; i++) {
    const bytes = damaged();
    try {
      const files = await filesOfZip(new File([bytes as BlobPart], "a.zip"), "a.zip");
      for (const get of files.values()) {
        const { blob } = await get();
        assert.ok(blob.size <= bytes.length);
      }
      read++;
    } catch (error) {
      assert.ok(
        error instanceof ReelError,
        `${error instanceof Error ? error.stack : String(error)}\n${bytes.toString("base64")}`,
      );
      assert.match(error.message, /a\.zip/);
      refused++;
    }
  }
  assert.ok(read > 30 && refused > 200, `${read} read, ${refused} refused`);
});
