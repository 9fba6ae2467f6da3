import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { parseManifest } from "../packages/decoder/src/reel/manifest";
import { fileOf } from "../packages/decoder/src/reel/reel-file";

const TEXT = readFileSync(join(process.cwd(), "../tests/data/golden-predictive/manifest.json"), "utf8");
const URL = "https://example.org/reel/manifest.json";

// eslint-disable-next-line @typescript-eslint/no-explicit-any
type Document = any;

function edited(change: (document: Document) => void): Document {
  const document = JSON.parse(TEXT);
  change(document);
  return document;
}

function withRenditions(document: Document): void {
  for (const [i, group] of document.groups.entries()) {
    group.renditions = {
      low: { uri: `groups/000${i}.low.safetensors`, bytes: 100 + i, sha256: "0".repeat(64), points: 7 },
    };
  }
  const sum = (files: Document[]): number => files.reduce((total, { bytes }) => total + bytes, 0);
  document.renditions = [
    { name: "high", bytes: sum(document.groups) },
    { name: "low", bytes: sum(document.groups.map((group: Document) => group.renditions.low)) },
  ];
}

test("a reel without renditions offers no choice", () => {
  assert.deepEqual(parseManifest(JSON.parse(TEXT), URL).renditions, []);
  const one = edited((document) => (document.renditions = [{ name: "high", bytes: 1 }]));
  assert.deepEqual(parseManifest(one, URL).renditions, []);
});

test("the background is the manifest's, or black", () => {
  assert.deepEqual(parseManifest(JSON.parse(TEXT), URL).background, [0, 0, 0]);
  assert.deepEqual(
    parseManifest(
      edited((document) => (document.background = [0, 0.5, 1])),
      URL,
    ).background,
    [0, 0.5, 1],
  );
  for (const bad of [null, "grey", [0.1, 0.2], [0, 0, 1.5], [0, -0.1, 0]]) {
    assert.throws(
      () =>
        parseManifest(
          edited((document) => (document.background = bad)),
          URL,
        ),
      { name: "ReelError" },
    );
  }
});

test("the clearance is the manifest's, or none", () => {
  assert.equal(parseManifest(JSON.parse(TEXT), URL).clearance.share, 0);
  const clearance = { focus: [1, -2, 3], share: 0.3 };
  assert.deepEqual(
    parseManifest(
      edited((document) => (document.clearance = clearance)),
      URL,
    ).clearance,
    clearance,
  );
  for (const bad of [
    null,
    3,
    {},
    { focus: [0, 0], share: 0.3 },
    { focus: [0, 0, 0], share: 1.5 },
    { focus: [0, 0, "1"], share: 0.3 },
  ]) {
    assert.throws(
      () =>
        parseManifest(
          edited((document) => (document.clearance = bad)),
          URL,
        ),
      { name: "ReelError" },
    );
  }
});

test("each group has a file in every rendition", () => {
  const manifest = parseManifest(edited(withRenditions), URL);
  assert.deepEqual(manifest.renditions, ["high", "low"]);
  const [first, second] = manifest.groups;
  assert.equal(fileOf(first, "high"), first);
  const low = fileOf(second, "low");
  assert.equal(low.uri, "groups/0001.low.safetensors");
  assert.deepEqual(
    [low.bytes, low.points, low.firstFrame, low.frames, low.group],
    [101, 7, second.firstFrame, second.frames, 1],
  );
});

test("incomplete renditions are rejected", () => {
  const changes: ((document: Document) => void)[] = [
    (d) => delete d.groups[1].renditions,
    (d) => delete d.groups[0].renditions.low.uri,
    (d) => (d.groups[0].renditions = []),
    (d) => (d.renditions[1].name = "high"),
    (d) => (d.renditions[1].name = "../x"),
    (d) => (d.renditions[1] = "low"),
    (d) => (d.renditions = {}),
  ];
  for (const change of changes) {
    const document = edited((d) => (withRenditions(d), change(d)));
    assert.throws(() => parseManifest(document, URL), { name: "ReelError" }, String(change));
  }
});

const SHA = "0".repeat(64);
const asset = (uri: string): Document => ({ uri, bytes: 10, sha256: SHA });

function presented(document: Document): void {
  Object.assign(document, {
    title: "Two chairs",
    poster: { ...asset("poster.jpg"), width: 640, height: 360 },
    thumbnails: {
      width: 96,
      height: 54,
      columns: 5,
      rows: 5,
      seconds: 0.5,
      count: 30,
      sheets: [asset("a.jpg"), asset("b.jpg")],
    },
    sound: {
      type: 'audio/mp4; codecs="opus"',
      rate: 48000,
      channels: 2,
      init: asset("i.mp4"),
      segments: [{ ...asset("0.m4s"), start: 0, seconds: 2 }],
    },
    limits: { focus: [0, 1, 0], angle: 25 },
  });
}

test("title, author and the other presentation fields are read, and may be absent", () => {
  const none = parseManifest(JSON.parse(TEXT), URL).presentation;
  assert.deepEqual([none.title, none.poster, none.thumbnails, none.sound, none.limits], ["", null, null, null, null]);
  const { title, poster, thumbnails, sound, limits } = parseManifest(edited(presented), URL).presentation;
  assert.equal(title, "Two chairs");
  assert.equal(poster!.uri, "poster.jpg");
  assert.equal(thumbnails!.sheets.length, 2);
  assert.deepEqual([sound!.segments[0].seconds, sound!.position], [2, null]);
  assert.deepEqual(limits, { focus: [0, 1, 0], angle: 25, distance: null, floor: null });
});

test("invalid presentation fields are rejected", () => {
  const bad: [string, (document: Document) => void][] = [
    ["text", (d) => (d.title = 7)],
    ["poster path", (d) => (d.poster.uri = "https://example.org/x.jpg")],
    ["poster size", (d) => (d.poster.width = 0)],
    ["sheets", (d) => (d.thumbnails.count = 51)],
    ["sound type", (d) => (d.sound.type = "text/html")],
    ["segments", (d) => (d.sound.segments[0].start = null)],
    ["focus", (d) => (d.limits.focus = [0, 0])],
    ["distances", (d) => (d.limits.distance = [3, 1])],
  ];
  for (const [what, change] of bad)
    assert.throws(
      () =>
        parseManifest(
          edited((d) => (presented(d), change(d))),
          URL,
        ),
      { name: "ReelError" },
      what,
    );
});
