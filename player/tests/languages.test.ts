import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { directionOf, wordsOf } from "../packages/element/src/base/words";
import { bestLanguage, languageOf } from "../packages/element/src/ui/language";
import "./fakes/page";

const source = fileURLToPath(new URL("../packages/element/src/", import.meta.url));
const read = (path: string): string => readFileSync(source + path, "utf8");
const languages = readdirSync(`${source}languages`).map((file) => /language-(\w+)\.ts/.exec(file)![1]);
const tables = new Map<string, Record<string, string>>();
for (const language of languages)
  tables.set(
    language,
    ((await import(`../packages/element/src/languages/language-${language}.ts`)) as { default: Record<string, string> })
      .default,
  );

/** Literals that are not texts: names of keys and events of the browser, and messages to authors of pages. */
const OTHERS =
  /^(Arrow\w*|Promise|Home|End|Escape|Tab|Enter|PageUp|PageDown|Esc|Space K|Home End|Shift .*|Files|Not\w+Error|AbortError|Ctrl|Mac.*|Event|Element|Segoe UI|Roboto|[A-Z]( [A-Z])*)$/;

/** Return the texts for people in the source: literals, and texts and labels of markup. */
function texts(): Set<string> {
  const files = [
    ...readdirSync(`${source}ui`)
      .filter(
        (file) =>
          file.endsWith(".ts") &&
          !["webvtt.ts", "declared-camera.ts", "annotations.ts", "cue-display.ts"].includes(file),
      )
      .map((file) => `ui/${file}`),
    "element/element.ts",
    "base/words.ts",
  ];
  const found = new Set<string>();
  const add = (text: string): void => void (!OTHERS.test(text) && found.add(text));
  for (const file of files) {
    const code = read(file)
      .replace(/\/\*[^]*?\*\/|^\s*\/\/.*$/gm, "")
      .replace(/^import .*$/gm, "")
      .replace(/new (?:DOMException|Error|TypeError|ReelError)\([^]*?\);/g, "")
      .replace(/`<splat-reel [^`]*`/g, "");
    for (const [, text] of code.matchAll(/(?<![=\w])"([A-Z{][^"\\]*[a-z}.%][^"\\]*)"/g)) add(text);
    for (const [, text] of code.matchAll(/(?:aria-label|title)="([A-Z][^"$]*)"/g)) add(text.replace(/ \(\S\)$/, ""));
    for (const [, text] of code.matchAll(/(?:>|\$\{[A-Z]+\})\s*([A-Z][^<>$`{}]*[a-z.]|at)\s*</g)) add(text);
    for (const [, text] of code.matchAll(/\b(?:choice|toggle|field)\("\w+", "([^"]+)"/g)) add(text);
  }
  const errors = readFileSync(
    fileURLToPath(new URL("../packages/decoder/src/base/errors.ts", import.meta.url)),
    "utf8",
  );
  for (const [, text] of errors.slice(0, errors.indexOf("};")).matchAll(/: "([^"]+)"/g)) add(text);
  for (const text of ["Offline. Waiting for the network.", "Live. Waiting for the first group."]) add(text);
  return found;
}

test("each language has all texts and no others", () => {
  assert.equal(languages.length, 7, "and English");
  const wanted = [...texts()].sort();
  for (const [language, table] of tables) {
    assert.deepEqual(
      wanted.filter((text) => !(text in table)),
      [],
      `${language} lacks texts`,
    );
    assert.deepEqual(
      Object.keys(table).filter((text) => !wanted.includes(text)),
      [],
      `${language} has texts that nothing shows`,
    );
  }
});

/** Width of a text in Latin letters: letters of Chinese and Japanese are twice as wide. */
const widthOf = (text: string): number => [...text].reduce((sum, letter) => sum + (letter > "\u2e80" ? 2 : 1), 0);

test("no text is empty, much longer than the English one, or lacks a value", () => {
  for (const [language, table] of tables) {
    for (const [english, text] of Object.entries(table)) {
      assert.ok(
        text.trim() !== "" && widthOf(text) <= Math.max(1.6 * english.length, english.length + 18),
        `${language}, ${english}: ${text}`,
      );
      const values = (words: string): string[] => (words.match(/\{\d\}/g) ?? []).sort();
      assert.deepEqual(values(text), values(english), `${language}, ${english}`);
    }
  }
});

test("the most wanted language that there is is chosen", () => {
  assert.equal(bestLanguage(["nl", "pt-BR", "de"]), "pt");
  assert.equal(bestLanguage(["en-GB", "de"]), "en");
  assert.equal(bestLanguage(["tlh"]), "en");
  assert.deepEqual([directionOf("ar"), directionOf("ja")], ["rtl", "ltr"]);
});

test("the nearest ancestor with a language decides, else the browser", () => {
  Object.assign(globalThis, { ShadowRoot: class {} });
  Object.assign(navigator, { languages: ["fr-CH", "en"] });
  const within = (lang: string | null): Element =>
    ({ closest: () => lang && { getAttribute: () => lang }, getRootNode: () => document }) as unknown as Element;
  assert.deepEqual(
    ["de-AT", "xx", null].map((lang) => languageOf(within(lang))),
    ["de", "en", "fr"],
  );
});

test("values take their places", () => {
  const t = wordsOf({ "{0} of {1}": "{1}, davon {0}" });
  assert.equal(t("{0} of {1}", "a", 2), "2, davon a");
  assert.equal(t("Loading {0} %", 5), "Loading 5 %");
});
