/** Fuzz target: any file either decodes or throws a `ReelError` that names the file and the section. See run.mjs. */
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { deflateSync, inflateSync } from "node:zlib";
import { ReelError } from "../packages/decoder/src/base/errors";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { decodePaper } from "../packages/decoder/src/decode/paper";
import { decodeDraco } from "../packages/decoder/src/decode/draco";
import type { Track } from "../packages/decoder/src/decode/mp4";
import { parseManifest } from "../packages/decoder/src/reel/manifest";

const NAME = "groups/it.safetensors";
const MAX_EDITS = 12;
const VALUES: unknown[] = [
  0,
  1,
  -1,
  2,
  255,
  2 ** 16,
  2 ** 26,
  2 ** 31,
  2 ** 40,
  2 ** 64,
  -(2 ** 53),
  1e308,
  0.5,
  -0.5,
  1e-300,
  null,
  true,
  false,
  "",
  "x",
  "../x",
  "/etc/x",
  "//host/x",
  "http://host/x",
  "h265",
  "lattice",
  "klt",
  "draco",
  "vq",
  [],
  [0],
  [0, 0, 0],
  [1, -1, 1e300],
  {},
  { codec: "klt" },
  [[0], [0]],
  "a".repeat(5000),
  new Array(300).fill(0),
];

type Json = Record<string, unknown>;
type Seed = { manifest: Json } | Draft;

/** A file as its parts. places: false entries of the safetensors header. */
interface Draft {
  own: Json & { sections: Record<string, Json> };
  sections: Record<string, Buffer>;
  places: Record<string, Json>;
}

const packages = join(process.cwd(), "node_modules");
const seeds = ["golden", "golden-predictive"].flatMap((name) => read(join(process.cwd(), "../tests/data", name)));
const addressOf = (name: string): string => pathToFileURL(join(packages, "draco3d", name)).href;
const files = {
  "draco-decode.js": addressOf("draco_decoder_nodejs.js"),
  "draco_decoder.wasm": addressOf("draco_decoder.wasm"),
};

/** Decode Draco as in a worker, by the package's own file. */
export const decodeCloud = (bytes: Uint8Array): Promise<Float32Array> => decodeDraco(bytes, files);

function read(folder: string): Seed[] {
  const drafts = ["layers", "groups"].flatMap((kind) =>
    readdirSync(join(folder, kind)).map((name) => draftOf(readFileSync(join(folder, kind, name)))),
  );
  return [...drafts, { manifest: JSON.parse(readFileSync(join(folder, "manifest.json"), "utf8")) }];
}

function draftOf(data: Buffer): Draft {
  const size = data.readUInt32LE(0);
  const header = JSON.parse(data.subarray(8, 8 + size).toString());
  const sections: Record<string, Buffer> = {};
  for (const [name, { data_offsets: at }] of Object.entries<{ data_offsets: number[] }>(header)) {
    if (at) sections[name] = data.subarray(8 + size + at[0], 8 + size + at[1]);
  }
  return { own: JSON.parse(header.__metadata__.splatreel), sections, places: {} };
}

/** Copy the parts of a seed that edits change. Bytes are never changed in place. */
function copyOf(seed: Seed): Seed {
  return "manifest" in seed
    ? structuredClone(seed)
    : { own: structuredClone(seed.own), sections: { ...seed.sections }, places: {} };
}

function pack({ own, sections, places }: Draft): Buffer {
  const header: Json = { __metadata__: { splatreel: JSON.stringify(own) } };
  let at = 0;
  for (const [name, data] of Object.entries(sections)) {
    header[name] = { dtype: "U8", shape: [data.length], data_offsets: [at, (at += data.length)], ...places[name] };
  }
  const text = Buffer.from(JSON.stringify(header));
  const size = Buffer.alloc(8);
  size.writeUInt32LE(text.length);
  return Buffer.concat([size, text, ...Object.values(sections)]);
}

/** Reads numbers from bytes. Past the end all are 0. */
class Program {
  private at = 0;

  constructor(private readonly data: Buffer) {}

  get left(): boolean {
    return this.at < this.data.length;
  }

  byte(): number {
    return this.data[this.at++] ?? 0;
  }

  below(count: number): number {
    return (count <= 256 ? this.byte() : this.byte() + 256 * this.byte() + 65536 * this.byte()) % count;
  }
}

/** Decode the file that a program makes of a seed. Throws unexpected errors. */
export async function fuzz(data: Buffer): Promise<void> {
  const program = new Program(data);
  const seed = copyOf(seeds[program.below(seeds.length)]);
  try {
    if ("manifest" in seed) {
      for (let i = 0; i < MAX_EDITS && program.left; i++) editJson(seed.manifest, program);
      parseManifest(JSON.parse(JSON.stringify(seed.manifest)), NAME);
    } else {
      for (let i = 0; i < MAX_EDITS && program.left; i++) edit(seed, program);
      await decodeFile(new Uint8Array(damaged(pack(seed), program)), NAME, (file, kernels) =>
        decodePaper(file, decodeCloud, decodeTrack, kernels),
      );
    }
  } catch (error) {
    check(error, "manifest" in seed);
  }
}

/** Check that an error names the file and the section, and that its root cause is a `ReelError`. */
function check(error: unknown, manifest: boolean): void {
  let cause = error;
  while (cause instanceof Error && cause.cause !== undefined) cause = cause.cause;
  if (!(error instanceof ReelError) || !(cause instanceof ReelError)) throw cause;
  if (!manifest && !error.message.startsWith(NAME))
    throw new Error(`The error does not name the file: ${error.message}`);
}

/** Return gray frames instead of running the video decoder, which is third-party and cannot be guided. */
export async function decodeTrack(track: Track): Promise<Uint8Array> {
  return new Uint8Array(track.width * track.height * track.samples.length).fill(128);
}

function edit(draft: Draft, program: Program): void {
  const names = Object.keys(draft.sections).sort();
  const kind = program.byte() % 8;
  if (kind < 3 || names.length === 0) return editJson(draft.own, program);
  const name = names[program.below(names.length)];
  if (kind < 5) draft.sections[name] = damaged(draft.sections[name], program, true);
  else if (kind === 5) draft.sections[name] = inside(draft.sections[name], program);
  else if (kind === 6) {
    const others = seeds.filter((seed): seed is Draft => "own" in seed);
    const other = others[program.below(others.length)];
    const taken = Object.keys(other.sections)[program.below(Object.keys(other.sections).length)];
    draft.sections[taken] = other.sections[taken];
    if (typeof draft.own.sections === "object" && draft.own.sections)
      draft.own.sections[taken] = structuredClone(other.own.sections[taken]);
  } else
    draft.places[name] = {
      [["dtype", "shape", "data_offsets"][program.below(3)]]: VALUES[program.below(VALUES.length)],
    };
}

/** Change the data of a section before it is deflated. */
function inside(data: Buffer, program: Program): Buffer {
  try {
    return deflateSync(damaged(inflateSync(data), program, true));
  } catch {
    return data;
  }
}

/** Replace or remove a value somewhere in a document. */
function editJson(document: Json, program: Program): void {
  for (let owner = document, keys; (keys = Object.keys(owner)).length;) {
    const key = keys[program.below(keys.length)];
    const value = owner[key];
    if (typeof value !== "object" || value === null || Object.keys(value).length === 0 || program.byte() % 8 === 0)
      return editValue(owner, key, program);
    owner = value as Json;
  }
}

function editValue(owner: Json, key: string, program: Program): void {
  const kind = program.byte() % 4;
  const value = owner[key];
  if (kind === 0) delete owner[key];
  else if (kind === 1) owner[key] = program.byte() - 20;
  else if (kind === 2 && typeof value === "number") owner[key] = value + program.byte() - 128;
  else owner[key] = structuredClone(VALUES[program.below(VALUES.length)]);
}

/** Apply one edit to bytes: change, insert, remove or cut; none at the end of the program. */
function damaged(data: Buffer, program: Program, always = false): Buffer {
  if (!always && !program.left) return data;
  const kind = program.byte() % 6;
  const at = program.below(data.length + 1);
  const [head, tail] = [data.subarray(0, at), data.subarray(at)];
  if (kind === 0) return Buffer.concat([head, Buffer.of((tail[0] ?? 0) ^ (program.byte() || 1)), tail.subarray(1)]);
  if (kind === 1) return head;
  if (kind === 2) return Buffer.concat([head, tail.subarray(1 + program.byte())]);
  if (kind === 3) return Buffer.concat([head, Buffer.alloc(1 + program.byte(), program.byte()), tail]);
  const word = Buffer.alloc(4);
  word[kind === 4 ? "writeUInt32LE" : "writeUInt32BE"](Number(VALUES[program.below(9)]) >>> 0);
  return Buffer.concat([head, word, tail.subarray(4)]);
}
