/** The seek bar: where time is, what is here already, and which time is under the pointer. */
import { elementOf } from "./markup";
import type { Player } from "./player";
import { timeText } from "./timetext";

const MARKUP = `<div class="track">
  <input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" />
  <span class="hint" aria-hidden="true"></span>
</div>`;

export class SeekBar {
  readonly box = elementOf(MARKUP);
  readonly input = this.box.querySelector<HTMLInputElement>(".seek")!;
  /** A hand is on it. */
  dragging = false;

  private readonly hint = this.box.querySelector<HTMLElement>(".hint")!;

  constructor(private readonly player: Player) {
    const { input } = this;
    input.addEventListener("input", () => {
      this.dragging = true;
      player.currentTime = Number(input.value);
    });
    input.addEventListener("change", () => (this.dragging = false));
    this.box.addEventListener("pointermove", (event) => this.showHint(event));
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

  private showHint(event: PointerEvent): void {
    const { left, width } = this.input.getBoundingClientRect();
    const part = Math.min(Math.max((event.clientX - left) / width, 0), 1);
    this.hint.textContent = timeText(part * this.player.duration, true);
    this.hint.style.left = `${Math.min(Math.max(part * width, 24), width - 24)}px`;
  }

  /** The ranges that are here, as a background. */
  private bufferedTrack(): string {
    const { buffered, duration } = this.player;
    const stops = buffered.flatMap(([from, to]) => {
      const [a, b] = [percent(from, duration), percent(to, duration)];
      return [`transparent ${a}%`, `rgb(255 255 255 / 0.36) ${a}%`, `rgb(255 255 255 / 0.36) ${b}%`, `transparent ${b}%`];
    });
    return stops.length > 0 ? `linear-gradient(to right, ${stops.join(", ")})` : "linear-gradient(transparent, transparent)";
  }
}

function percent(part: number, whole: number): number {
  return whole > 0 ? Math.round((10000 * part) / whole) / 100 : 0;
}
