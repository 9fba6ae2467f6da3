import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { deflateRawSync } from "node:zlib";
import { ReelError } from "../packages/decoder/src/base/errors";
import { filesOfZip, openDropped, openFiles } from "../packages/element/src/files/open-files";

interface Packed {
  name: string;
  bytes: Buffer;
  method?: number;
  flags?: number;
}

/** A zip of these files; comment: what follows its end. */
function zip(files: Packed[], comment = ""): Buffer {
  const [bodies, directory]: Buffer[][] = [[], []];
  let offset = 0;
  for (const { name, bytes, method = 8, flags = 0 } of files) {
    const packed = method === 8 ? deflateRawSync(bytes) : bytes;
    const shared = Buffer.alloc(26);
    shared.writeUInt16LE(20, 0);
    shared.writeUInt16LE(flags, 2);
    shared.writeUInt16LE(method, 4);
    shared.writeUInt32LE(packed.length, 14);
    shared.writeUInt32LE(bytes.length, 18);
    shared.writeUInt16LE(name.length, 22);
    const local = Buffer.concat([Buffer.from("PK\x03\x04", "latin1"), shared, Buffer.from(name), packed]);
    const rest = Buffer.alloc(14);
    rest.writeUInt32LE(offset, 10);
    directory.push(Buffer.concat([Buffer.from("PK\x01\x02\x14\x00", "latin1"), shared, rest, Buffer.from(name)]));
    bodies.push(local);
    offset += local.length;
  }
  const end = Buffer.alloc(18);
  const listed = Buffer.concat(directory);
  end.writeUInt16LE(files.length, 4);
  end.writeUInt16LE(files.length, 6);
  end.writeUInt32LE(listed.length, 8);
  end.writeUInt32LE(offset, 12);
  end.writeUInt16LE(comment.length, 16);
  return Buffer.concat([...bodies, listed, Buffer.from("PK\x05\x06", "latin1"), end, Buffer.from(comment)]);
}

const text = (words: string): Buffer => Buffer.from(words);
const file = (bytes: Buffer, name = "a.zip"): File => new File([bytes as BlobPart], name);
const GOLDEN = join(process.cwd(), "../tests/data/golden/manifest.json");

test("files of a zip are read, stored or deflated, with a comment at its end", async () => {
  const long = Buffer.alloc(5000, "long ");
  const files = await filesOfZip(
    file(
      zip(
        [
          { name: "a/b.txt", bytes: long },
          { name: "c.txt", bytes: text("c"), method: 0 },
          { name: "a/", bytes: text(""), method: 0 },
        ],
        "PK said",
      ),
    ),
    "a.zip",
  );
  assert.deepEqual([...files.keys()], ["a/b.txt", "c.txt"]);
  const part = await files.get("a/b.txt")!();
  assert.equal(part.deflated, true);
  assert.equal(
    await new Response(part.blob.stream().pipeThrough(new DecompressionStream("deflate-raw"))).text(),
    long.toString(),
  );
  assert.equal(await (await files.get("c.txt")!()).blob.text(), "c");
});

test("the reel in a zip is found, also in a folder of it", async () => {
  const manifest = readFileSync(GOLDEN);
  const bytes = zip([
    { name: "out/reel/manifest.json", bytes: manifest },
    { name: "out/reel/groups/0000.safetensors", bytes: text("group") },
    { name: "__MACOSX/manifest.json", bytes: text("") },
  ]);
  const reel = await openFiles([file(bytes)]);
  assert.equal(await reel.manifest(), manifest.toString());
  assert.ok(reel.part("groups/0000.safetensors").blob.size > 0);
  assert.equal(reel.part("../manifest.json").blob.size, 0);
});

test("a truncated, damaged, encrypted or unsupported zip is rejected with the reason", async () => {
  const good = zip([{ name: "manifest.json", bytes: text("{}") }]);
  const damaged = Buffer.from(good);
  damaged[0] = 0;
  const directory = Buffer.from(good);
  directory.writeUInt32LE(1, good.indexOf("PK\x01\x02", 0, "latin1"));
  const outside = Buffer.from(good);
  outside.writeUInt32LE(0xfffffff, good.length - 6);
  const large = Buffer.from(good);
  large.writeUInt32LE(0xffffffff, good.length - 6);
  const cases: [Buffer, RegExp][] = [
    [good.subarray(0, good.length - 5), /a\.zip cannot be read: it is not a zip, or it was cut off/],
    [damaged, /damaged at manifest\.json/],
    [directory, /its directory is damaged/],
    [outside, /it is damaged/],
    [large, /larger than 4 GB. Unzip it/],
    [zip([{ name: "manifest.json", bytes: text("{}"), flags: 1 }]), /manifest\.json is encrypted/],
    [zip([{ name: "manifest.json", bytes: text("{}"), method: 12 }]), /compressed in a way \(12\)/],
  ];
  for (const [bytes, message] of cases) await assert.rejects(openFiles([file(bytes)]), { name: "ReelError", message });
});

test("a file that is not a reel is named by its kind", async () => {
  const cases: [File[], RegExp][] = [
    [[file(text("ply"), "scene.ply")], /That is not a reel: scene\.ply is a single static scene.*Give the folder/],
    [[file(text("mp4"), "film.MP4")], /film\.MP4 is an ordinary video/],
    [[file(text("{}"), "manifest.json")], /manifest\.json is only one file of a reel/],
    [[file(zip([{ name: "a.txt", bytes: text("a") }]))], /a\.zip holds no manifest\.json/],
    [
      [
        file(
          zip([
            { name: "a/manifest.json", bytes: text("a") },
            { name: "b/manifest.json", bytes: text("a") },
          ]),
        ),
      ],
      /several reels: a\/manifest\.json and b\/manifest\.json/,
    ],
    [[], /There is no file/],
  ];
  for (const [files, message] of cases) await assert.rejects(openFiles(files), { name: "ReelError", message });
});

/** A folder as browsers give it: few entries at a time, until there are none. */
function folder(name: string, inside: object): FileSystemEntry {
  const entries = Object.entries(inside).map(([key, value]) =>
    typeof value === "string"
      ? {
          name: key,
          isFile: true,
          isDirectory: false,
          file: (resolve: (file: File) => void) => resolve(file(text(value), key)),
        }
      : folder(key, value as object),
  );
  const createReader = () => {
    const left = [...entries];
    return { readEntries: (resolve: (some: unknown[]) => void) => resolve(left.splice(0, 2)) };
  };
  return { name, isFile: false, isDirectory: true, createReader } as unknown as FileSystemEntry;
}

test("the reel in a dropped folder is found, also in a nested one", async () => {
  const files = {
    "a.txt": "a",
    "b.txt": "b",
    "c.txt": "c",
    reel: { "manifest.json": "{}", groups: { "0000.safetensors": "group" } },
  };
  const reel = await openDropped({ entries: [folder("out", files)], files: [] });
  assert.equal(reel.name, "out");
  assert.equal(await reel.manifest(), "{}");
  assert.equal(await reel.part("groups/0000.safetensors").blob.text(), "group");
  assert.equal(reel.part("a.txt").blob.size, 0);
  await assert.rejects(openDropped({ entries: [folder("empty", { "a.txt": "a" })], files: [] }), {
    message: /empty holds no manifest\.json/,
  });
});

// Damaged at random, the same in every run: each gives its files, or an error in words.
let state = 7;
const random = (below: number): number => {
  state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
  return Math.floor((state / 2 ** 32) * below);
};
const GOOD = zip([
  { name: "manifest.json", bytes: text("{}") },
  { name: "groups/0.bin", bytes: Buffer.alloc(500, "group") },
  { name: "layers/0.bin", bytes: Buffer.from([...Array(200).keys()]) },
]);

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

// Names that point out of a zip: no file outside of the reel's folder is part of the reel.
/** A zip of files that are stored as they are, under any name. */
const stored = (files: [string, string][]): File =>
  file(zip(files.map(([name, words]) => ({ name, bytes: text(words), method: 0 }))), "reel.zip");
const sizeOf = async (files: [string, string][], uri: string): Promise<number> =>
  (await openFiles([stored(files)])).part(uri).blob.size;

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
    stored([
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
