/** The seek bar: where time is, what is here already, and which time is under the pointer. */
import type { Player } from "../player/player";
import { elementOf } from "./markup";
import { Thumbnails } from "./thumbnails";
import { timeText } from "./time-text";

const MARKUP = `<div class="track">
  <input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" />
  <span class="hint" aria-hidden="true"><span class="at"></span></span>
</div>`;

export class SeekBar {
  readonly box = elementOf(MARKUP);
  readonly input = this.box.querySelector<HTMLInputElement>(".seek")!;
  /** A hand is on it. */
  dragging = false;

  private readonly hint = this.box.querySelector<HTMLElement>(".hint")!;
  private readonly thumbnails: Thumbnails;

  constructor(private readonly player: Player) {
    const { input, box } = this;
    this.thumbnails = new Thumbnails(player);
    this.hint.prepend(this.thumbnails.box);
    const drag = (on: boolean): void => {
      this.dragging = on;
      box.classList.toggle("dragged", on);
    };
    input.addEventListener("input", () => {
      drag(true);
      player.currentTime = Number(input.value);
      this.showHint(player.currentTime / player.duration);
    });
    input.addEventListener("change", () => drag(false));
    box.addEventListener("pointermove", ({ clientX, pointerType }) => {
      const { left, width } = input.getBoundingClientRect();
      if (pointerType !== "touch") this.showHint((clientX - left) / width);
    });
  }

  /** Show how things are. */
  update(): void {
    const { input } = this;
    const { currentTime, duration } = this.player;
    input.max = String(duration);
    if (!this.dragging) input.value = String(currentTime);
    input.setAttribute("aria-valuetext", `${timeText(currentTime, duration < 60)} of ${timeText(duration, duration < 60)}`);
    input.style.setProperty("--played", `${percent(currentTime, duration)}%`);
    input.style.setProperty("--ahead", this.bufferedTrack());
  }

  /** What is at a part of the bar, which stays within it. */
  private showHint(place: number): void {
    const { hint, player: { duration } } = this;
    const part = Math.min(Math.max(place, 0), 1) || 0;
    hint.querySelector(".at")!.textContent = timeText(part * duration, true);
    this.thumbnails.show(part * duration);
    const width = this.box.clientWidth;
    const half = hint.offsetWidth / 2;
    hint.style.left = `${Math.min(Math.max(part * width, half), width - half)}px`;
  }

  /** The ranges that are here, as a background. */
  private bufferedTrack(): string {
    const { buffered, duration } = this.player;
    const stops = buffered.flatMap(([from, to]) => {
      const [a, b] = [percent(from, duration), percent(to, duration)];
      return [`transparent ${a}%`, `var(--here) ${a}%`, `var(--here) ${b}%`, `transparent ${b}%`];
    });
    return stops.length > 0 ? `linear-gradient(to right, ${stops.join(", ")})` : "linear-gradient(transparent, transparent)";
  }
}

function percent(part: number, whole: number): number {
  return whole > 0 ? Math.round((10000 * part) / whole) / 100 : 0;
}
