/** The help: keys and gestures, and what they do. */
import type { KeyTable } from "./keys";

/** The help's content as markup. */
export function helpMarkup(table: KeyTable): string {
  const section = ([title, lines]: KeyTable[number]): string => `<section><h3>${title}</h3><dl>${lines.map(({ shown, what }) => `<dt>${keycaps(shown)}</dt><dd>${what}</dd>`).join("")}</dl></section>`;
  return `<h2>Keys</h2><div class="columns">${table.map(section).join("")}</div>
    <p>Drag to turn, right or Shift drag or two fingers to move, scroll or pinch for nearer and farther, double-click to choose the middle.</p>`;
}

function keycaps(shown: string): string {
  return shown.split(" ").map((key) => (key === "–" ? "–" : `<kbd>${key.replace("<", "&lt;")}</kbd>`)).join(" ");
}
