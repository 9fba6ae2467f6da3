/** Captions and chapters from the `<track>` children of an element. This part is loaded on demand. */
import { messageOf } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";
import type { Chapter, TextTracks } from "../player/text-tracks";
import { CueDisplay } from "./cue-display";
import { adoptStyles } from "./styles";
import styles from "./tracks.css";
import { parseCues, plainText, type Cue } from "./webvtt";

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
