/** The seek bar: present time, buffered ranges, and the time under the pointer. */
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";
import { elementOf } from "./markup";
import type { Thumbnails } from "./thumbnails";
import { timeText } from "./time-text";

const MARKUP = `<div class="track">
  <input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" />
  <span class="section" aria-hidden="true" hidden></span>
  <span class="marks" aria-hidden="true"></span>
  <span class="hint" aria-hidden="true"><span class="chapter"></span><span class="at"></span></span>
</div>`;

/** The seek bar of one player. */
export class SeekBar {
  readonly box: HTMLElement;
  readonly input: HTMLInputElement;
  /** True during a drag. */
  dragging = false;

  private readonly hint: HTMLElement;
  private thumbnails: Promise<Thumbnails> | null = null;
  /** Places of the chapter marks on the bar. */
  private marked = "";

  constructor(private readonly player: Player) {
    this.box = elementOf(MARKUP, player.words);
    this.input = this.box.querySelector(".seek")!;
    this.hint = this.box.querySelector(".hint")!;
    const { input, box } = this;
    const drag = (on: boolean): void => {
      this.dragging = on;
      box.classList.toggle("dragged", on);
    };
    input.addEventListener("input", () => {
      drag(true);
      player.currentTime = Number(input.value);
      this.showHint(this.placeOf(player.currentTime));
    });
    input.addEventListener("change", () => drag(false));
    box.addEventListener("pointermove", ({ clientX, pointerType }) => {
      const { left, width } = input.getBoundingClientRect();
      if (pointerType !== "touch") this.showHint((clientX - left) / width);
    });
  }

  /** Show the present state. */
  update(): void {
    const { input } = this;
    const { currentTime, earliest, duration } = this.player;
    [input.min, input.max] = [String(earliest), String(duration)];
    if (!this.dragging) input.value = String(currentTime);
    const chapter = this.titleAt(currentTime);
    input.setAttribute(
      "aria-valuetext",
      this.player.words("{0} of {1}", timeText(currentTime, duration < 60), timeText(duration, duration < 60)) +
        (chapter && `, ${chapter}`),
    );
    this.updateMarks();
    this.updateSection();
    input.style.setProperty("--played", `${this.percent(currentTime)}%`);
    input.style.setProperty("--ahead", this.bufferedTrack());
  }

  /** Show the time and thumbnail at a position of the bar, 0 to 1. */
  private showHint(place: number): void {
    const {
      hint,
      player: { earliest, duration },
    } = this;
    const part = Math.min(Math.max(place, 0), 1) || 0;
    const seconds = earliest + part * (duration - earliest);
    hint.querySelector(".chapter")!.textContent = this.titleAt(seconds);
    hint.querySelector(".at")!.textContent = timeText(seconds, true);
    this.placeHint(part);
    this.showThumbnail(seconds, part);
  }

  /** Place the hint above a position of the bar, within the picture. */
  private placeHint(part: number): void {
    const width = this.box.clientWidth;
    const half = this.hint.offsetWidth / 2;
    this.hint.style.left = `${Math.min(Math.max(part * width, half), width - half)}px`;
  }

  /** Show the thumbnail of a time, if the reel has any. They are a part that is loaded on demand. */
  private showThumbnail(seconds: number, part: number): void {
    const { player, hint } = this;
    if (!this.thumbnails && !player.manifest?.presentation.thumbnails) return;
    this.thumbnails ??= loadPart("thumbnails.js", () => import("./thumbnails")).then(({ Thumbnails }) => {
      const thumbnails = new Thumbnails(player);
      hint.prepend(thumbnails.box);
      return thumbnails;
    });
    const show = (thumbnails: Thumbnails): void => {
      thumbnails.show(seconds);
      this.placeHint(part); // the thumbnail has changed the width
    };
    this.thumbnails.then(show, () => undefined);
  }

  /** Return the title of the chapter at a time; "" for none. */
  private titleAt(seconds: number): string {
    const { tracks } = this.player;
    return tracks?.chapters[tracks.chapterAt(seconds)]?.title ?? "";
  }

  /** Show where chapters begin. */
  private updateMarks(): void {
    const { tracks, earliest, duration } = this.player;
    const places = (tracks?.chapters ?? [])
      .filter(({ start }) => start > earliest && start < duration)
      .map(({ start }) => `${this.percent(start)}%`);
    if (places.join() === this.marked) return;
    this.marked = places.join();
    this.box.querySelector(".marks")!.replaceChildren(
      ...places.map((place) => {
        const mark = document.createElement("i");
        mark.style.left = place;
        return mark;
      }),
    );
  }

  /** Show the part that repeats. */
  private updateSection(): void {
    const { section } = this.player;
    const box = this.box.querySelector<HTMLElement>(".section")!;
    box.hidden = !section;
    if (section)
      Object.assign(box.style, { left: `${this.percent(section[0])}%`, right: `${100 - this.percent(section[1])}%` });
  }

  /** Return the buffered ranges as a background image. */
  private bufferedTrack(): string {
    const stops = this.player.buffered.flatMap(([from, to]) => {
      const [a, b] = [this.percent(from), this.percent(to)];
      return [`transparent ${a}%`, `var(--here) ${a}%`, `var(--here) ${b}%`, `transparent ${b}%`];
    });
    return stops.length > 0
      ? `linear-gradient(to right, ${stops.join(", ")})`
      : "linear-gradient(transparent, transparent)";
  }

  /** Return the position of a time on the bar, 0 to 1. */
  private placeOf(seconds: number): number {
    const { earliest, duration } = this.player;
    return duration > earliest ? (seconds - earliest) / (duration - earliest) : 0;
  }

  private percent(seconds: number): number {
    return Math.round(10000 * this.placeOf(seconds)) / 100;
  }
}
