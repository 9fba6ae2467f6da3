import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { fileOf, parseManifest } from "../src/manifest";

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
  document.renditions = [{ name: "high", bytes: 1 }, { name: "low", bytes: 2 }];
  for (const [i, group] of document.groups.entries()) {
    group.renditions = { low: { uri: `groups/000${i}.low.safetensors`, bytes: 100 + i, sha256: "0".repeat(64), points: 7 } };
  }
}

test("a reel without renditions has none to choose from", () => {
  assert.deepEqual(parseManifest(JSON.parse(TEXT), URL).renditions, []);
  const one = edited((document) => (document.renditions = [{ name: "high", bytes: 1 }]));
  assert.deepEqual(parseManifest(one, URL).renditions, []);
});

test("behind everything is the manifest's background, or black", () => {
  assert.deepEqual(parseManifest(JSON.parse(TEXT), URL).background, [0, 0, 0]);
  assert.deepEqual(parseManifest(edited((document) => (document.background = [0, 0.5, 1])), URL).background, [0, 0.5, 1]);
  for (const bad of [null, "grey", [0.1, 0.2], [0, 0, 1.5], [0, -0.1, 0]]) {
    assert.throws(() => parseManifest(edited((document) => (document.background = bad)), URL), { name: "ReelError" });
  }
});

test("a viewer has the room that the manifest says, or none", () => {
  assert.equal(parseManifest(JSON.parse(TEXT), URL).clearance.share, 0);
  const clearance = { focus: [1, -2, 3], share: 0.3 };
  assert.deepEqual(parseManifest(edited((document) => (document.clearance = clearance)), URL).clearance, clearance);
  for (const bad of [null, 3, {}, { focus: [0, 0], share: 0.3 }, { focus: [0, 0, 0], share: 1.5 }, { focus: [0, 0, "1"], share: 0.3 }]) {
    assert.throws(() => parseManifest(edited((document) => (document.clearance = bad)), URL), { name: "ReelError" });
  }
});

test("each group has a file in every rendition", () => {
  const manifest = parseManifest(edited(withRenditions), URL);
  const own = manifest.groups.reduce((sum, group) => sum + group.bytes, 0);
  assert.deepEqual(manifest.renditions, [{ name: "high", bytes: own }, { name: "low", bytes: 201 }]);
  const [first, second] = manifest.groups;
  assert.equal(fileOf(first, "high"), first);
  const low = fileOf(second, "low");
  assert.equal(low.uri, "groups/0001.low.safetensors");
  assert.deepEqual([low.bytes, low.points, low.firstFrame, low.frames, low.group], [101, 7, second.firstFrame, second.frames, 1]);
});

test("renditions that are not whole are refused", () => {
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
