/** A copy of what shows, outside the graphics device: what is left of the picture when the device is lost. */
import type { Player } from "../player/player";

/** Milliseconds between copies while pictures follow each other, and after the last one. */
const EVERY = 1000;
const REST = 300;
/** Pixels of the widest copy. */
const WIDTH = 1280;

export class LastPicture {
  private copy: HTMLCanvasElement | null = null;
  private taken = 0;
  private timer = 0;

  constructor(private readonly player: Player) {
    player.addEventListener("drawn", () => this.drawn());
    player.addEventListener("canplay", () => this.take()); // drawn for this event
    player.addEventListener("emptied", () => this.forget());
  }

  /** Null where nothing was drawn yet. */
  get canvas(): HTMLCanvasElement | null {
    return this.copy;
  }

  private drawn(): void {
    clearTimeout(this.timer);
    if (this.player.presented) return; // a headset shows it
    // What was drawn can be read until the browser shows it.
    if (performance.now() - this.taken > EVERY) return this.take();
    this.timer = window.setTimeout(() => this.player.playback.redraw() && this.take(), REST);
  }

  private take(): void {
    const { canvas } = this.player;
    if (canvas.width === 0 || canvas.height === 0) return;
    const copy = (this.copy ??= document.createElement("canvas"));
    const scale = Math.min(WIDTH / canvas.width, 1);
    [copy.width, copy.height] = [Math.round(scale * canvas.width), Math.max(Math.round(scale * canvas.height), 1)];
    // Kept in memory: what the device holds is lost with it.
    copy.getContext("2d", { willReadFrequently: true })!.drawImage(canvas, 0, 0, copy.width, copy.height);
    this.taken = performance.now();
  }

  private forget(): void {
    clearTimeout(this.timer);
    [this.copy, this.taken] = [null, 0];
  }
}
