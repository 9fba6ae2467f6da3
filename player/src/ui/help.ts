/** The help: lists keys and gestures. This part is loaded on demand. */
import styles from "./help.css";
import type { KeyTable } from "./keys";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";

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

/** Return the content of the help. root: of the dialog. Touch gestures come first on touch screens. */
export function helpOf(root: ShadowRoot, table: KeyTable): HTMLElement {
  adoptStyles(root, styles);
  const touch = matchMedia("(pointer: coarse)").matches;
  const [time, view] = table.map(([title, lines]) => section(title, lines.filter(({ applies }) => applies?.() ?? true).map(({ shown, what }) => [keycaps(shown), what])));
  const gestures = touch ? section("Touch", TOUCH) : section("Mouse", MOUSE);
  return elementOf(`<div class="columns">${(touch ? [gestures, time, view] : [time, gestures, view]).join("")}</div>`);
}

function section(title: string, lines: [string, string][]): string {
  return `<section><h3>${title}</h3><dl>${lines.map(([shown, what]) => `<dt>${shown}</dt><dd>${what}</dd>`).join("")}</dl></section>`;
}

function keycaps(shown: string): string {
  return shown.split(" ").map((key) => (key === "–" ? "–" : `<kbd>${key.replace("<", "&lt;")}</kbd>`)).join(" ");
}
