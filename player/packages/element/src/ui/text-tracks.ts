/** Captions and chapters from the `<track>` children of an element. This part is loaded on demand. */
import { elementOf } from "./markup";
import { type Cue, parseCues, parseMarkup, type Piece, plainText } from "./webvtt";
import { messageOf } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";
import type { Chapter, TextTracks } from "../player/text-tracks";
import { adoptStyles } from "./styles";
import styles from "./tracks.css";

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

/** Seconds into a chapter after which a step back goes to its start. */
const BACK = 2;

interface Captions {
  element: HTMLElement;
  name: string;
  language: string;
  /** Cues; null until they are downloaded. */
  cues: readonly Cue[] | null;
}

/** The tracks of one element. */
export class Tracks implements TextTracks {
  chapters: readonly Chapter[] = [];

  private readonly display = new CueDisplay();
  private readonly life = new AbortController();
  private list: Captions[] = [];
  private index = -1;
  /** Captions that `toggle` shows again. */
  private last = 0;
  /** Number of readings of the children, by which an older one detects a newer one. */
  private readings = 0;

  /** host: element with the children. say: shows a failure to people. */
  constructor(
    private readonly host: HTMLElement,
    root: ShadowRoot,
    private readonly player: Player,
    private readonly say: (words: string) => void,
  ) {
    const { signal } = this.life;
    adoptStyles(root, styles);
    root.querySelector(".poster")!.after(this.display.box);
    for (const name of ["timeupdate", "emptied", "loadedmetadata"])
      player.addEventListener(name, () => this.display.show(this.cuesNow(), this.language), { signal });
    signal.addEventListener("abort", () => this.display.box.remove());
    this.read();
  }

  /** Remove captions and chapters. */
  remove(): void {
    this.readings++;
    this.life.abort();
    [this.list, this.chapters] = [[], []];
    this.player.emit("trackchange");
  }

  /** Read the children again, after they changed. */
  read(): void {
    const tracks = [...this.host.querySelectorAll<HTMLElement>(":scope > track[src]")];
    const kind = (element: HTMLElement): string => (element.getAttribute("kind") ?? "subtitles").toLowerCase();
    const before = this.list;
    this.list = tracks
      .filter((element) => ["captions", "subtitles"].includes(kind(element)))
      .map((element, i) => {
        const language = element.getAttribute("srclang") ?? "";
        const known = before.find((captions) => captions.element === element && captions.name === nameOf(element, i));
        return { element, language, name: nameOf(element, i), cues: known?.cues ?? null };
      });
    const number = ++this.readings;
    this.select();
    const chapters = tracks.find((element) => kind(element) === "chapters");
    this.chapters = [];
    if (chapters) void this.cuesOf(chapters).then((cues) => number === this.readings && this.setChapters(cues));
    this.player.emit("trackchange");
  }

  /** Show the captions that the attribute `captions` names, else those with the attribute `default`. */
  select(): void {
    const wanted = this.host.getAttribute("captions");
    const names = ({ name, language }: Captions): boolean =>
      [name, language].some((text) => text.toLowerCase() === wanted!.toLowerCase());
    this.index = this.list.findIndex((captions) =>
      wanted === null ? captions.element.hasAttribute("default") : names(captions),
    );
    if (this.index >= 0) this.last = this.index;
    void this.load();
    this.player.emit("trackchange");
  }

  get captions(): string[] {
    return this.list.map(({ name }) => name);
  }

  get shown(): number {
    return this.index;
  }

  /** Show captions; -1 for none. The attribute `captions` keeps the choice. */
  set shown(index: number) {
    this.host.setAttribute("captions", this.list[index]?.name ?? "off");
  }

  toggle(): void {
    if (this.list.length > 0) this.shown = this.index >= 0 ? -1 : Math.min(this.last, this.list.length - 1);
  }

  chapterAt(seconds: number): number {
    return this.chapters.findLastIndex(({ start, end }) => start <= seconds && seconds <= end);
  }

  step(by: 1 | -1): void {
    const { player } = this;
    const { currentTime, duration, earliest } = player;
    const starts = this.chapters.map(({ start }) => start);
    if (starts.length === 0) return;
    const begun = currentTime - Math.min(BACK, duration / 20);
    const to =
      by > 0 ? starts.find((start) => start > currentTime) : (starts.findLast((start) => start <= begun) ?? earliest);
    if (to !== undefined) player.currentTime = to;
  }

  private get language(): string {
    return this.list[this.index]?.language ?? "";
  }

  private cuesNow(): Cue[] {
    const { manifest, currentTime } = this.player;
    const cues = manifest ? this.list[this.index]?.cues : null;
    return (cues ?? []).filter(({ start, end }) => start <= currentTime && currentTime < end);
  }

  private async load(): Promise<void> {
    const captions = this.list[this.index];
    if (captions && !captions.cues) captions.cues = await this.cuesOf(captions.element);
    this.display.show(this.cuesNow(), this.language);
  }

  private setChapters(cues: readonly Cue[]): void {
    this.chapters = cues.map(({ start, end, text }) => ({ title: plainText(text), start, end }));
    this.player.emit("trackchange");
  }

  /** Download the cues of a track. A failure is shown, and dispatched as the event `error` of the track. */
  private async cuesOf(element: HTMLElement): Promise<readonly Cue[]> {
    const address = new URL(element.getAttribute("src")!, document.baseURI).href;
    try {
      const answer = await fetch(address, {
        credentials: this.player.access.credentials ?? "same-origin",
        signal: this.life.signal,
      });
      if (!answer.ok) throw new Error(`it answered ${answer.status}`);
      const { cues, unreadable } = parseCues(await answer.text());
      if (unreadable > 0)
        console.warn(`${address}: ${unreadable} cues are left out, because their times cannot be read.`);
      element.dispatchEvent(new Event("load"));
      return cues;
    } catch (error) {
      if (this.life.signal.aborted) return [];
      console.warn(`${address} cannot be used: ${messageOf(error)}.`);
      this.say(
        element.getAttribute("kind") === "chapters"
          ? "The chapters cannot be loaded"
          : "These captions cannot be loaded",
      );
      element.dispatchEvent(new Event("error"));
      return [];
    }
  }
}

/** Return the label of a track, else the name of its language, else its number. */
function nameOf(element: HTMLElement, index: number): string {
  const language = element.getAttribute("srclang") ?? "";
  const label = element.getAttribute("label");
  if (label || !language) return label || `${index + 1}`;
  try {
    return new Intl.DisplayNames([language], { type: "language" }).of(language) ?? language;
  } catch {
    return language; // not a valid language tag
  }
}
