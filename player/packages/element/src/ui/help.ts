/** The help: lists keys and gestures. This part is loaded on demand. */
import type { Words } from "../base/words";
import styles from "./help.css";
import type { KeyTable } from "./keys";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";

/** Keys and their effects, by the first key of a line. */
export const LINES: Record<string, [shown: string, what: string]> = {
  " ": ["Space K", "Play or pause"],
  arrowleft: ["← →", "Back or on, up to 5 s"],
  j: ["J L", "Back or on, up to 10 s"],
  ",": [", .", "One frame"],
  "0": ["0 – 9", "To tenths of the reel"],
  home: ["Home End", "To the ends"],
  b: ["B N", "Chapter before, after"],
  t: ["T", "Captions on or off"],
  "<": ["< >", "Slower or faster"],
  o: ["O", "Repeat from here, to here, no more"],
  arrowup: ["↑ ↓", "Louder, softer"],
  m: ["M", "Sound on or off"],
  s: ["W A S D", "Walk"],
  e: ["Q E", "Down, up"],
  "shift+arrowleft": ["Shift ← → ↑ ↓", "Turn about the middle"],
  "+": ["+ −", "Nearer, farther"],
  "[": ["[ ]", "Cameras of the capture"],
  c: ["C", "Fly through them"],
  g: ["G", "Walk mode"],
  r: ["R", "Reset the view"],
  f: ["F", "Fullscreen"],
  v: ["V", "Virtual reality, with a headset"],
  p: ["P", "Save a picture"],
  i: ["I", "Statistics"],
  "?": ["?", "These keys"],
  "shift+f10": ["Shift F10", "Menu of the picture"],
  escape: ["Esc", "Close"],
};
const TOUCH: [string, string][] = [
  ["Drag", "Turn"],
  ["Two fingers", "Move"],
  ["Pinch", "Nearer, farther"],
  ["Double tap", "Make that the middle"],
  ["Double tap at a side", "Back or on, up to 10 s"],
  ["Hold", "Twice as fast"],
  ["Tap", "Controls on, off"],
];
const MOUSE: [string, string][] = [
  ["Drag", "Turn"],
  ["Right drag, Shift drag", "Move"],
  ["Scroll", "Nearer, farther"],
  ["Double click", "Make that the middle"],
  ["Hold", "Twice as fast"],
  ["Right click", "Menu"],
];

/** Return the content of the help. root: of the dialog. On touch screens the keys are folded away. */
export function helpOf(root: ShadowRoot, table: KeyTable, t: Words): HTMLElement {
  adoptStyles(root, styles);
  const touch = matchMedia("(pointer: coarse)").matches;
  const keys = (lines: KeyTable[0]): [string, string][] =>
    lines
      .filter(({ applies }) => applies?.() ?? true)
      .map(({ bindings }) => LINES[bindings[0].keys[0]])
      .map(([shown, what]) => [keycaps(shown), t(what)]);
  const [time, view] = [section(t("Time"), keys(table[0])), section(t("View"), keys(table[1]))];
  const gestures = section(
    t(touch ? "Touch" : "Mouse"),
    (touch ? TOUCH : MOUSE).map(([gesture, what]) => [t(gesture), t(what)]),
  );
  return elementOf(
    touch
      ? `<div>${gestures}<details><summary>${t("Keyboard")}</summary><div class="columns">${time}${view}</div></details></div>`
      : `<div class="columns">${time}${gestures}${view}</div>`,
  );
}

function section(title: string, lines: [string, string][]): string {
  return `<section><h3>${title}</h3><dl>${lines.map(([shown, what]) => `<dt>${shown}</dt><dd>${what}</dd>`).join("")}</dl></section>`;
}

function keycaps(shown: string): string {
  return shown
    .split(" ")
    .map((key) => (key === "–" ? "–" : `<kbd>${key.replace("<", "&lt;")}</kbd>`))
    .join(" ");
}
