/** The language of an element: that of the nearest ancestor with `lang`, else the first of the browser's that there is. */
import { wordsOf, type Words } from "../base/words";
import { loadPart } from "@splatreel/renderer";

type Table = Promise<{ default: Record<string, string> }>;

/** Languages besides English. Each is a part that is loaded on demand. */
const TABLES: Record<string, () => Table> = {
  ar: () => loadPart("language-ar.js", () => import("../languages/language-ar")),
  de: () => loadPart("language-de.js", () => import("../languages/language-de")),
  es: () => loadPart("language-es.js", () => import("../languages/language-es")),
  fr: () => loadPart("language-fr.js", () => import("../languages/language-fr")),
  ja: () => loadPart("language-ja.js", () => import("../languages/language-ja")),
  pt: () => loadPart("language-pt.js", () => import("../languages/language-pt")),
  zh: () => loadPart("language-zh.js", () => import("../languages/language-zh")),
};

/** Return the first language that there is, as in `lang`; "en" if there is none. */
export function bestLanguage(wanted: readonly string[]): string {
  const languages = wanted.map((name) => name.toLowerCase().split("-")[0]);
  return languages.find((language) => language === "en" || language in TABLES) ?? "en";
}

/** Return the language of an element. */
export function languageOf(element: Element): string {
  for (let at: Element | null = element; at;) {
    const near: Element | null = at.closest("[lang]");
    if (near?.getAttribute("lang")) return bestLanguage([near.getAttribute("lang")!]);
    const root: Node = (near ?? at).getRootNode();
    at = near?.parentElement ?? (root instanceof ShadowRoot ? root.host : null);
  }
  return bestLanguage(navigator.languages);
}

/** Load the texts of a language; null for English, which needs no file. */
export async function loadWords(language: string): Promise<Words | null> {
  return language in TABLES ? wordsOf((await TABLES[language]()).default) : null;
}
