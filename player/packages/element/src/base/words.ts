/** Texts for people. English texts are their own keys, so that only other languages need a table. */

/** Return a text in the language of the player. Values replace {0}, {1} and so on. */
export type Words = (english: string, ...values: (string | number)[]) => string;

/** The texts in English. */
export const ENGLISH: Words = wordsOf({});

/** Return the texts of a table, which maps English texts to those of a language. */
export function wordsOf(table: Record<string, string>): Words {
  return (english, ...values) => (table[english] ?? english).replace(/\{(\d)\}/g, (_, i) => String(values[i]));
}

/** English message if a part of the player cannot be loaded. */
export const LACKING = "This part of the player cannot be loaded";

/** Return the direction in which a language of the player is written. */
export function directionOf(language: string): "ltr" | "rtl" {
  return language === "ar" ? "rtl" : "ltr";
}
