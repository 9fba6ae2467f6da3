/** Zips whose names point out of them: nothing is written anywhere, and no file outside of the reel's folder is part of the reel. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { openFiles } from "../packages/element/src/files/open-files";

/** A zip of files that are stored as they are, under any name. */
function zip(files: [string, string][]): File {
  const [bodies, directory] = [[] as Buffer[], [] as Buffer[]];
  let offset = 0;
  for (const [name, text] of files) {
    const [bytes, called] = [Buffer.from(text), Buffer.from(name)];
    const shared = Buffer.alloc(26);
    shared.writeUInt16LE(20, 0);
    for (const at of [14, 18]) shared.writeUInt32LE(bytes.length, at);
    shared.writeUInt16LE(called.length, 22);
    const rest = Buffer.alloc(14);
    rest.writeUInt32LE(offset, 10);
    directory.push(Buffer.concat([Buffer.from("PK\x01\x02\x14\x00", "latin1"), shared, rest, called]));
    bodies.push(Buffer.concat([Buffer.from("PK\x03\x04", "latin1"), shared, called, bytes]));
    offset += bodies.at(-1)!.length;
  }
  const listed = Buffer.concat(directory);
  const end = Buffer.alloc(22);
  end.write("PK\x05\x06", "latin1");
  for (const at of [8, 10]) end.writeUInt16LE(bodies.length, at);
  end.writeUInt32LE(listed.length, 12);
  end.writeUInt32LE(offset, 16);
  return new File([Buffer.concat([...bodies, listed, end]) as BlobPart], "reel.zip");
}

const sizeOf = async (files: [string, string][], uri: string): Promise<number> =>
  (await openFiles([zip(files)])).part(uri).blob.size;

test("names that point out of the zip are ignored", async () => {
  const files: [string, string][] = [
    ["reel/manifest.json", "{}"],
    ["reel/groups/0000.safetensors", "inside"],
    ["groups/0001.safetensors", "outside"],
    ["../groups/0001.safetensors", "outside"],
    ["/groups/0001.safetensors", "outside"],
    ["C:\\groups\\0001.safetensors", "outside"],
    ["other/groups/0001.safetensors", "outside"],
  ];
  assert.equal(await sizeOf(files, "groups/0000.safetensors"), 6);
  assert.equal(await sizeOf(files, "groups/0001.safetensors"), 0);
  assert.equal(await sizeOf(files, "../groups/0001.safetensors"), 0);
});

test("a manifest outside of the zip adds no files from beside it", async () => {
  const reel = await openFiles([
    zip([
      ["../../manifest.json", "{}"],
      ["../../a.bin", "beside"],
      ["a.bin", "within"],
    ]),
  ]);
  assert.equal(await reel.manifest(), "{}");
  assert.equal(await reel.part("a.bin").blob.text(), "beside");
  assert.equal(reel.part("../../a.bin").blob.size, 0);
});

test("names of JavaScript's own properties are ordinary names", async () => {
  const files: [string, string][] = [
    ["manifest.json", "{}"],
    ["__proto__/a.bin", "mine"],
    ["constructor", "mine"],
  ];
  assert.equal(await sizeOf(files, "__proto__/a.bin"), 4);
  assert.equal(await sizeOf(files, "toString"), 0);
});
