import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { PLAIN } from "../packages/decoder/src/base/errors";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { parseManifest, type Manifest } from "../packages/decoder/src/reel/manifest";
import { withKnown, withPage } from "../packages/decoder/src/reel/pages";
import { layersAt } from "../packages/decoder/src/reel/reel-file";
import { ADDRESS, documentOf, manifestOf, pageAt, type Plan } from "./fakes/reel";

const never = (): never => assert.fail("it is of the predictive codec");

// eslint-disable-next-line @typescript-eslint/no-explicit-any
type Json = any;

/** Fourteen groups from the fifth on: two pages of five, and four that the manifest lists itself. */
const PLAN: Plan = { groups: 19, first: 5, page: 5, layers: [0, [5, 12], [5, 7], [7, 12], 8, [12, 99], 16] };
const known = (manifest: Manifest): string => Object.keys(manifest.groups).join(" ");
const withPageOf = (manifest: Manifest, index: number, change: (json: Json) => void = () => undefined): Manifest => {
  const page = manifest.pages[index];
  const json = pageAt(PLAN, page.uri);
  change(json);
  return withPage(manifest, page, json);
};
const living = (manifest: Manifest, group: number): string =>
  layersAt(manifest.groups[group])
    .map(({ uri }) => /\d+/.exec(uri)![0])
    .join(" ");

test("groups keep their numbers, and groups of pages are missing until the pages arrive", () => {
  const manifest = manifestOf(PLAN);
  assert.deepEqual(
    [manifest.first, manifest.groups.length, manifest.frames, known(manifest)],
    [5, 19, 190, "15 16 17 18"],
  );
  assert.deepEqual(
    manifest.pages.map(({ uri, group, count, firstFrame, frames }) => [uri, group, count, firstFrame, frames]),
    [
      ["pages/5.json", 5, 5, 50, 50],
      ["pages/10.json", 10, 5, 100, 50],
    ],
  );
  assert.deepEqual(manifest.groups[16].uri, "groups/16.bin");
  const more = withPageOf(manifest, 1);
  assert.equal(known(more), "10 11 12 13 14 15 16 17 18");
  assert.equal(known(manifest), "15 16 17 18", "the manifest before is as it was");
  assert.equal(known(withPageOf(more, 0)), [...Array(14)].map((_, i) => i + 5).join(" "));
});

test("a group shows its living layers in order of birth, from any list", () => {
  const manifest = withPageOf(withPageOf(manifestOf(PLAN), 0), 1);
  const expected: [number, string][] = [
    [5, "0 1 2"],
    [6, "0 1 2"],
    [7, "0 1 3"],
    [8, "0 1 3 4"],
    [11, "0 1 3 4"],
    [12, "0 4 5"],
    [15, "0 4 5"],
    [16, "0 4 5 6"],
  ];
  for (const [group, layers] of expected) assert.equal(living(manifest, group), layers, String(group));
});

test("in a group, layers that never retire come before the others", () => {
  const manifest = manifestOf({ groups: 4, page: 2, layers: [0, [0, 3], [0, 1]] });
  const page = {
    layers: [
      { ...fileOf("layers/1.bin"), group: 0, first_frame: 0, until: 3 },
      { ...fileOf("layers/2.bin"), group: 0, first_frame: 0, until: 1 },
    ],
    groups: pageAt({ groups: 4, page: 2 }, "pages/0.json").groups,
  };
  const whole = withPage(manifest, manifest.pages[0], page);
  assert.deepEqual(
    [0, 1, 2, 3].map((group) => living(whole, group)),
    ["0 1 2", "0 1", "0 1", "0"],
  );
});

test("a reel of version 1 has no retired layers, pages or dropped groups, whatever its manifest contains", () => {
  const document: Json = { ...documentOf({ groups: 3, layers: [0, [1, 2]] }), version: 1, first_group: 7, pages: 3 };
  const manifest = parseManifest(document, ADDRESS);
  assert.deepEqual([manifest.first, manifest.pages, living(manifest, 2)], [0, [], "0 1"]);
});

test("a later version is rejected in plain words", () => {
  assert.throws(() => parseManifest({ ...documentOf(), version: 3 }, ADDRESS), {
    name: "ReelError",
    plain: PLAIN.newer,
    message: /version 3; this player knows versions 1 and 2/,
  });
});

test("values that version 2 forbids are rejected", () => {
  const bad: [RegExp, (document: Json) => void][] = [
    [/first_group is -1/, (d) => (d.first_group = -1)],
    [/first_group is 1.5/, (d) => (d.first_group = 1.5)],
    [/pages is not a list/, (d) => (d.pages = {})],
    [/groups of a page is 0/, (d) => (d.pages[0].groups = 0)],
    [/only plain relative paths/, (d) => (d.pages[0].uri = "../x.json")],
    [/bytes is 0/, (d) => (d.pages[0].bytes = 0)],
    [/first_frame of a page is 50/, (d) => (d.pages[1].first_frame = 50)],
    [/pages end after its groups begin/, (d) => Object.assign(d.pages[1], { first_frame: 150, frames: 40 })],
    [/until of layers\/5.bin is 12/, (d) => (d.layers.find((layer: Json) => layer.until).until = 12)],
    [/holds no group/, (d) => (d.groups = d.layers = [])],
  ];
  for (const [message, change] of bad) {
    const document = documentOf(PLAN);
    change(document);
    assert.throws(() => parseManifest(document, ADDRESS), { name: "ReelError", message });
  }
});

test("a page that contradicts the manifest is rejected by name", () => {
  const bad: ((json: Json) => void)[] = [
    (json) => json.groups.pop(),
    (json) => json.groups.push(json.groups[0]),
    (json) => (json.groups = []),
    (json) => (json.groups = "x"),
    (json) => delete json.layers,
    (json) => (json.groups[0].first_frame = 51),
    (json) => (json.groups[4].frames = 11),
    (json) => (json.groups[2].uri = "/etc/passwd"),
    (json) => (json.layers[0].points = 1e9),
  ];
  for (const change of bad)
    assert.throws(
      () => withPageOf(manifestOf(PLAN), 0, change),
      { name: "ReelError", message: /^pages\/5.json cannot be used\. / },
      String(change),
    );
  assert.throws(() => withPage(manifestOf(PLAN), manifestOf(PLAN).pages[0], null), {
    name: "ReelError",
    message: /^pages\/5.json/,
  });
});

test("groups that a live reel moved into a page stay known; dropped groups do not", () => {
  const before = withPageOf(manifestOf(PLAN), 1);
  const next = manifestOf({ ...PLAN, groups: 22, first: 10 });
  assert.deepEqual([known(next), next.pages.map(({ uri }) => uri)], ["20 21", ["pages/10.json", "pages/15.json"]]);
  assert.equal(known(withKnown(next, before)), "10 11 12 13 14 20 21", "group 19 of the second page was not known");
  const grown = withKnown(manifestOf({ ...PLAN, groups: 20 }), before);
  assert.equal(known(withKnown(next, grown)), [...Array(12)].map((_, i) => i + 10).join(" "));
  assert.equal(living(withKnown(next, grown), 11), "0 1 3 4");
});

test("an impossible number of bytes is an error that names the file", () => {
  for (const bytes of [-1, 0, 1.5, 2 ** 40, "5", null]) {
    const document: Json = documentOf();
    document.groups[1].bytes = bytes;
    assert.throws(() => parseManifest(document, ADDRESS), {
      name: "ReelError",
      message: /bytes of groups\/1\.bin is /,
    });
  }
});

function fileOf(uri: string): Json {
  return { uri, bytes: 500, sha256: "0".repeat(64), points: 100 };
}

const golden = (path: string): Buffer => readFileSync(join(process.cwd(), "../tests/data", path));

for (const name of ["golden-long", "golden-window"]) {
  test(`in ${name} the layers that live at a group are those that Python finds, and its bits are for their points`, async () => {
    const found = parseManifest(JSON.parse(golden(`${name}/manifest.json`).toString()), ADDRESS);
    const whole = found.pages.reduce(
      (manifest, page) => withPage(manifest, page, JSON.parse(golden(`${name}/${page.uri}`).toString())),
      found,
    );
    const { living } = JSON.parse(golden(`${name}/expected.json`).toString());
    assert.deepEqual(Object.keys(whole.groups), Object.keys(living));
    for (const group of Object.values(whole.groups)) {
      const layers = layersAt(group);
      assert.deepEqual(
        layers.map(({ uri }) => uri),
        living[group.group],
      );
      const { alive } = await decodeFile(new Uint8Array(golden(`${name}/${group.uri}`)), group.uri, never);
      assert.equal(
        alive.length,
        layers.reduce((sum, { points }) => sum + points, 0),
      );
    }
  });
}
