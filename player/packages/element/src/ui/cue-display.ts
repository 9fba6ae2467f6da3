/** Cues over the picture, above the bar. */
import { elementOf } from "./markup";
import { parseMarkup, type Cue, type Piece } from "./webvtt";

const ALIGNMENTS = ["start", "center", "end", "left", "right"];
/** Lines of text that fit on the picture, for cues whose line is counted. */
const LINES = 16;

/** The cues that are shown now. */
export class CueDisplay {
  readonly box = elementOf(`<div class="cues"><div class="stack"></div></div>`);
  private shown: readonly Cue[] = [];

  /** Show these cues. language: of their text, as in `lang`. */
  show(cues: readonly Cue[], language: string): void {
    if (cues.length === this.shown.length && cues.every((cue, i) => cue === this.shown[i])) return;
    this.shown = cues;
    this.box.lang = language;
    const stack = this.box.querySelector(".stack")!;
    const [placed, stacked] = [cues.filter(hasPlace), cues.filter((cue) => !hasPlace(cue))];
    stack.replaceChildren(...stacked.map(elementOfCue));
    this.box.replaceChildren(stack, ...placed.map(elementOfCue));
    for (const [i, cue] of placed.entries()) place(this.box.children[i + 1] as HTMLElement, cue.settings);
  }
}

/** Return true if a cue names its place. Others are stacked above the bar. */
function hasPlace({ settings }: Cue): boolean {
  return settings.has("line") || settings.has("vertical");
}

function elementOfCue({ text, settings }: Cue): HTMLElement {
  const box = elementOf(`<p class="cue"><span></span></p>`);
  box.firstElementChild!.append(...parseMarkup(text).map(nodeOf));
  const align = settings.get("align") ?? "";
  if (ALIGNMENTS.includes(align)) box.style.textAlign = align;
  return box;
}

/** Place a cue by its settings `line`, `position`, `size` and `vertical`. */
function place(box: HTMLElement, settings: Map<string, string>): void {
  const vertical = settings.get("vertical") ?? "";
  const [line, position, size] = ["line", "position", "size"].map((name) => percentOf(settings.get(name)));
  const width = size ?? 100;
  const align = settings.get("align") ?? "center";
  const anchor = { start: 0, left: 0, end: 1, right: 1 }[align] ?? 0.5;
  const begin = Math.min(Math.max((position ?? 100 * anchor) - anchor * width, 0), 100 - width);
  const [side, extent] = vertical ? (["top", "height"] as const) : (["left", "width"] as const);
  Object.assign(box.style, { position: "absolute", [side]: `${begin}%`, [extent]: `${width}%` });
  if (vertical) box.style.writingMode = vertical === "lr" ? "vertical-lr" : "vertical-rl";
  const at = line ?? (vertical ? 0 : 90);
  const low = vertical === "rl" ? "right" : vertical ? "left" : "top";
  box.style[low] = `${at}%`;
  // A cue near the end of the picture lies before its line, so that it stays within.
  if (at > 50) box.style.translate = vertical === "rl" ? `${at}% 0` : vertical ? `${-at}% 0` : `0 ${-at}%`;
}

/** Return a setting in percent. Counted lines count from the top, negative ones from the bottom. */
function percentOf(value: string | undefined): number | null {
  const number = Number.parseFloat(value ?? "");
  if (!Number.isFinite(number)) return null;
  const percent = value!.includes("%") ? number : (100 * (number < 0 ? LINES + number : number)) / LINES;
  return Math.min(Math.max(percent, 0), 100);
}

function nodeOf(piece: Piece): Node {
  if (typeof piece === "string") return document.createTextNode(piece);
  const { tag, classes, note, pieces } = piece;
  const element = document.createElement(tag === "c" || tag === "v" || tag === "lang" ? "span" : tag);
  element.className = classes.join(" ");
  if (tag === "lang") element.lang = note;
  if (tag === "v") element.title = note;
  element.append(...pieces.map(nodeOf));
  return element;
}
