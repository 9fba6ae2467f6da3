/** Manifests that were damaged at random: each is read, or refused in words. The damage is the same in every run. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { ReelError } from "../packages/decoder/src/base/errors";
import { withPage } from "../packages/decoder/src/reel/pages";
import { missingPages, momentAt } from "../packages/decoder/src/reel/timeline";
import { loadManifest, parseManifest, sourceOf, type Manifest } from "../packages/decoder/src/reel/manifest";
import type { ReelFile } from "../packages/decoder/src/reel/reel-file";
import "./fakes/page";

const URL = "https://page.example/reel/manifest.json";
const TEXTS = ["golden", "golden-predictive", "golden-long", "golden-window"].map((name) =>
  readFileSync(join(process.cwd(), "../tests/data", name, "manifest.json"), "utf8"),
);
const asset = (uri: string, more = {}) => ({ uri, bytes: 100, sha256: "0".repeat(64), ...more });
/** What golden reels have none of. */
const EXTRAS = {
  title: "A room",
  poster: asset("poster.jpg", { width: 16, height: 9 }),
  clearance: { focus: [0, 0, 0], share: 0.3 },
  background: [0, 0.5, 1],
  thumbnails: {
    width: 16,
    height: 9,
    columns: 2,
    rows: 2,
    seconds: 1,
    count: 5,
    sheets: [asset("t/0.jpg"), asset("t/1.jpg")],
  },
  sound: {
    type: 'audio/mp4; codecs="opus"',
    rate: 48000,
    channels: 2,
    init: asset("sound/init.mp4"),
    segments: [asset("sound/0.m4s", { start: 0, seconds: 2 }), asset("sound/1.m4s", { start: 2, seconds: 2 })],
    position: [0, 0, 1],
  },
  limits: { focus: [0, 0, 0], angle: 30, distance: [1, 8], floor: -1 },
};
/** What stands where something else should. */
const JUNK: unknown[] = [
  null,
  true,
  -1,
  0,
  0.5,
  1e300,
  2 ** 53,
  "",
  "x",
  "../../etc/passwd",
  "https://other.example/a",
  [],
  [[]],
  {},
  { uri: 3 },
  [null],
  Array(20).fill(0),
  NaN,
];

let state = 1;
const random = (below: number): number => {
  state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
  return Math.floor((state / 2 ** 32) * below);
};
const oneOf = <T>(values: T[]): T => values[random(values.length)];

/** Every object and list within, with the names of what they hold. */
function places(value: unknown): [Record<string, unknown>, string][] {
  if (typeof value !== "object" || value === null) return [];
  const inside = value as Record<string, unknown>;
  return Object.keys(inside).flatMap((key) => [
    [inside, key] as [Record<string, unknown>, string],
    ...places(inside[key]),
  ]);
}

/** Put junk in one place, take something away, double it, or exchange it with another. */
function damage(document: unknown): void {
  const all = places(document);
  const [[holder, key], [other, name]] = [oneOf(all), oneOf(all)];
  const act = random(5);
  if (act === 0) delete holder[key];
  else if (act === 1 && Array.isArray(holder)) holder.push(structuredClone(holder[0]));
  else if (act === 2) holder[key] = structuredClone(other[name]);
  else holder[key] = structuredClone(oneOf(JUNK));
}

/** What the player counts on. */
function check(manifest: Manifest): void {
  const groups = Object.values(manifest.groups);
  const files = [...manifest.layers, ...groups, ...groups.flatMap((group) => [...group.renditions.values()])];
  for (const frame of groups.length > 0 ? [-1, 0, manifest.frames / 2, 1e9] : []) {
    const missing = missingPages(manifest, frame);
    assert.ok(missing.every((page) => manifest.pages.includes(page)));
    assert.equal(momentAt(manifest, 1, frame) === null, missing.length > 0);
  }
  const finite = (numbers: number[]): void => assert.ok(numbers.every(Number.isFinite), String(numbers));
  finite([
    manifest.fps,
    manifest.frames,
    manifest.overlap,
    manifest.near,
    ...manifest.bounds.flat(),
    ...manifest.up,
    ...manifest.background,
  ]);
  assert.ok(manifest.fps > 0 && manifest.near > 0 && (manifest.groups.length > 0 || manifest.live));
  for (const { K, viewmat, width, height } of [manifest.camera, ...manifest.cameras]) {
    finite([...K, ...viewmat]);
    assert.ok(K.length === 9 && viewmat.length === 16 && K[0] > 0 && K[4] > 0 && width > 0 && height > 0);
  }
  const sound = manifest.presentation.sound;
  const assets = [
    manifest.presentation.poster,
    ...(manifest.presentation.thumbnails?.sheets ?? []),
    ...(sound ? [sound.init, ...sound.segments] : []),
  ];
  for (const item of [...files, ...assets]) {
    if (!item) continue;
    const address = sourceOf(manifest, item).url;
    assert.ok(address.startsWith("https://page.example/reel/") && !address.includes(".."), address);
  }
  for (const { points, bytes, frames, firstFrame } of files as ReelFile[]) {
    finite([points, bytes, frames, firstFrame]);
    assert.ok(
      points >= 0 && points <= bytes + 131_072 && frames <= 10_000,
      `${points} points in ${bytes} bytes, ${frames} frames`,
    );
  }
  const names = manifest.renditions;
  assert.equal(new Set(names).size, names.length);
  for (const group of groups) assert.deepEqual([...group.renditions.keys()], names.slice(1));
}

function documents(): Record<string, unknown>[] {
  return TEXTS.flatMap((text) => {
    const [plain, full] = [JSON.parse(text), { ...JSON.parse(text), ...structuredClone(EXTRAS) }];
    const groups: { bytes: number; renditions: object }[] = full.groups;
    full.renditions = [
      { name: "high", bytes: groups.reduce((sum, { bytes }) => sum + bytes, 0) },
      { name: "low", bytes: 100 * groups.length },
    ];
    for (const page of full.pages ?? []) {
      page.rendition_bytes = { high: 1000, low: 100 };
      for (const rendition of full.renditions) rendition.bytes += page.rendition_bytes[rendition.name];
    }
    for (const [i, group] of groups.entries()) group.renditions = { low: asset(`groups/${i}.low.bin`, { points: 7 }) };
    return [plain, full];
  });
}

test("an undamaged manifest is read", () => {
  for (const document of documents()) check(parseManifest(document, URL));
});

test("a damaged manifest has valid values or raises a ReelError with the reason", () => {
  let refused = 0;
  for (let i = 0; i < 1500; i++) {
    const document = documents()[i % 8];
    for (let times = 1 + random(3); times > 0; times--) damage(document);
    const text = JSON.stringify(document);
    try {
      check(parseManifest(JSON.parse(text), URL));
    } catch (error) {
      assert.ok(error instanceof ReelError, `${error instanceof Error ? error.stack : String(error)}\n${text}`);
      assert.ok(error.message.length > 10 && error.message.length < 1000 && error.plain.length > 10, error.message);
      refused++;
    }
  }
  assert.ok(refused > 300 && refused < 1490, `${refused} of 1500 were refused`);
});

test("a damaged page has valid values or raises a ReelError that names it", () => {
  const manifest = parseManifest(JSON.parse(TEXTS[2]), URL);
  const texts = manifest.pages.map(({ uri }) =>
    readFileSync(join(process.cwd(), "../tests/data/golden-long", uri), "utf8"),
  );
  let refused = 0;
  for (let i = 0; i < 800; i++) {
    const page = manifest.pages[i % texts.length];
    const document = JSON.parse(texts[i % texts.length]);
    for (let times = 1 + random(3); times > 0; times--) damage(document);
    try {
      check(withPage(manifest, page, JSON.parse(JSON.stringify(document))));
    } catch (error) {
      assert.ok(
        error instanceof ReelError && error.message.startsWith(page.uri),
        `${error instanceof Error ? error.stack : String(error)}\n${JSON.stringify(document)}`,
      );
      refused++;
    }
  }
  assert.ok(refused > 150 && refused < 795, `${refused} of 800 were refused`);
});

test("truncated text and other text than JSON are rejected with a message", async () => {
  const quiet = { received: () => undefined, trouble: () => undefined };
  for (let length = 0; length < TEXTS[0].length - 2; length += 97) {
    const early = Promise.resolve(TEXTS[0].slice(0, length));
    await assert.rejects(loadManifest(URL, quiet, new AbortController().signal, undefined, early), {
      name: "ReelError",
      message: /not JSON/,
    });
  }
  const manifest = await loadManifest(
    "manifest.json",
    quiet,
    new AbortController().signal,
    undefined,
    Promise.resolve(TEXTS[0]),
  );
  assert.equal(manifest.url, "https://page.example/manifest.json");
});
