import assert from "node:assert/strict";
import { test } from "node:test";
import { parseCues, parseMarkup, plainText } from "../packages/element/src/ui/webvtt";

const FILE = `\ufeffWEBVTT - some words

NOTE this is not a cue

STYLE
::cue { color: red }

intro
00:01.000 --> 00:02.500 line:10% align:start
Hello
world

01:00:03.250 --> 01:00:04.000
Later

00:00.500 --> 00:03.000
<v Ada>First`;

test("cues have times in seconds, names, settings and text, in order of their start", () => {
  const { cues, unreadable } = parseCues(FILE.replaceAll("\n", "\r\n"));
  assert.equal(unreadable, 0);
  assert.deepEqual(
    cues.map(({ start, end }) => [start, end]),
    [
      [0.5, 3],
      [1, 2.5],
      [3603.25, 3604],
    ],
  );
  assert.deepEqual(
    [cues[1].id, cues[1].text, [...cues[1].settings]],
    [
      "intro",
      "Hello\nworld",
      [
        ["line", "10%"],
        ["align", "start"],
      ],
    ],
  );
});

test("cues whose times cannot be read are left out and counted", () => {
  const { cues, unreadable } = parseCues(
    "WEBVTT\n\n0:01.000 --> 00:02.000\na\n\n00:02.000 --> 00:01.000\nb\n\n00:61.000 --> 01:02.000\nc\n\n00:03.000 --> 00:04.000\nd",
  );
  assert.deepEqual([cues.map(({ text }) => text), unreadable], [["d"], 3]);
});

test("a file of another format is refused with its first line", () => {
  assert.throws(() => parseCues("1\n00:00:01,000 --> 00:00:02,000\nSubRip"), /first line is "1" instead of "WEBVTT"/);
  assert.throws(() => parseCues("WEBVTTX"), /WEBVTTX/);
  assert.throws(() => parseCues("<!doctype html>"), /doctype/);
  assert.deepEqual(parseCues("WEBVTT"), { cues: [], unreadable: 0 });
});

test("markup becomes a tree, and other tags leave their text", () => {
  assert.deepEqual(parseMarkup("a <b>bold <i>both</b> c</x> <00:01.000>d"), [
    "a ",
    { tag: "b", classes: [], note: "", pieces: ["bold ", { tag: "i", classes: [], note: "", pieces: ["both"] }] },
    " c",
    " ",
    "d",
  ]);
  assert.deepEqual(parseMarkup("<c.yellow.loud>x</c><v.first Ada &amp; Bob>y"), [
    { tag: "c", classes: ["yellow", "loud"], note: "", pieces: ["x"] },
    { tag: "v", classes: ["first"], note: "Ada & Bob", pieces: ["y"] },
  ]);
});

test("escapes stand for their letters, and markup of pages stays text", () => {
  assert.equal(plainText("1 &lt; 2 &amp;&nbsp;&#65;&#x42; &unknown;"), "1 < 2 & AB &unknown;");
  assert.equal(plainText("&lt;img src=x onerror=alert(1)&gt;"), "<img src=x onerror=alert(1)>");
  assert.equal(plainText("<img src=x onerror=alert(1)>two\nlines"), "two lines");
});

test("any text is parsed without an error", () => {
  let seed = 7;
  const random = (most: number): number => (seed = (seed * 48271) % 2147483647) % most;
  const bits = [
    "<",
    ">",
    "/",
    "b",
    "c.",
    " ",
    "&",
    "&#",
    ";",
    "9",
    "\n",
    "-->",
    "00:00.000",
    "WEBVTT",
    "</b>",
    "<ruby>",
  ];
  for (let i = 0; i < 500; i++) {
    const text = Array.from({ length: random(30) }, () => bits[random(bits.length)]).join("");
    parseMarkup(text);
    const { cues } = parseCues(`WEBVTT\n\n${text}\n\n00:00.000 --> 00:01.000\nend`);
    assert.ok(cues.length > 0);
  }
});
