/** Copy of the present frame in main memory, to show when the graphics device is lost. */
import type { Player } from "../player/player";

/** Milliseconds between copies during playback, and until the copy of the last frame. */
const EVERY = 1000;
const REST = 300;
/** Maximum width of a copy, in pixels. */
const WIDTH = 1280;

/** Takes copies of the canvas. */
export class LastPicture {
  private copy: HTMLCanvasElement | null = null;
  private taken = 0;
  private timer = 0;

  constructor(private readonly player: Player) {
    player.addEventListener("drawn", () => this.drawn());
    player.addEventListener("canplay", () => this.take()); // the frame is drawn before this event
    player.addEventListener("emptied", () => this.forget());
  }

  /** The last copy; null before the first complete frame. */
  get canvas(): HTMLCanvasElement | null {
    return this.copy;
  }

  private drawn(): void {
    clearTimeout(this.timer);
    if (this.player.presented) return; // a headset shows it
    if (!this.player.canPlay) return; // reading the canvas waits for the device, and would delay the first picture
    // A frame can be read until the browser presents it.
    if (performance.now() - this.taken > EVERY) return this.take();
    this.timer = window.setTimeout(() => this.player.playback.redraw() && this.take(), REST);
  }

  private take(): void {
    const { canvas } = this.player;
    if (canvas.width === 0 || canvas.height === 0) return;
    const copy = (this.copy ??= document.createElement("canvas"));
    const scale = Math.min(WIDTH / canvas.width, 1);
    [copy.width, copy.height] = [Math.round(scale * canvas.width), Math.max(Math.round(scale * canvas.height), 1)];
    // A canvas in main memory survives the loss of the device.
    copy.getContext("2d", { willReadFrequently: true })!.drawImage(canvas, 0, 0, copy.width, copy.height);
    this.taken = performance.now();
  }

  private forget(): void {
    clearTimeout(this.timer);
    [this.copy, this.taken] = [null, 0];
  }
}
