/** Image over the canvas until the reel is drawn: the poster, or the last frame of a reel that rests or has lost its device. */
import type { Player } from "../player/player";
import { addressOf, DeviceLostError, isSameReel } from "@splatreel/decoder/internal";

/** Milliseconds between copies during playback, and until the copy of the last frame. */
const EVERY = 1000;
const REST = 300;
/** Maximum width of a copy, in pixels. */
const WIDTH = 1280;

/** Takes copies of the canvas. */
class LastPicture {
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

/** Milliseconds of the cross-fade from the poster to the first frame. */
const FADE = 350;

/** Shows and hides the poster and the last frame. */
export class Poster {
  readonly image = document.createElement("img");
  private still: HTMLCanvasElement | null = null;
  /** View of the still. */
  private stillView = "";
  /** Address given by the page, which takes precedence over the manifest's. */
  private given = "";
  private fading: Animation | null = null;
  private readonly last: LastPicture;

  constructor(private readonly player: Player) {
    const { image } = this;
    this.last = new LastPicture(player);
    image.className = "poster";
    image.alt = "";
    image.fetchPriority = "high";
    player.addEventListener("loadedmetadata", () => void this.useOwn());
    player.addEventListener("drawn", () => this.drawn());
    player.addEventListener("canplay", () => this.drawn());
    player.addEventListener("emptied", () => this.clear());
    player.addEventListener(
      "error",
      () => this.player.error instanceof DeviceLostError && this.last.canvas && this.showStill(this.last.canvas),
    );
    this.clear();
  }

  /** Set the address given by the page; "" for the poster of the manifest. */
  give(url: string): void {
    this.given = url;
    this.show(url || this.player.prefetchedPoster);
    if (!url) void this.useOwn();
  }

  /** Keep the present frame of the canvas. */
  keep(): void {
    const { canvas } = this.player;
    if (!this.player.playback.redraw()) return;
    const still = document.createElement("canvas");
    [still.width, still.height] = [canvas.width, canvas.height];
    still.getContext("2d")!.drawImage(canvas, 0, 0);
    this.showStill(still);
  }

  private showStill(still: HTMLCanvasElement): void {
    still.className = "poster still";
    this.hide();
    this.blank(true);
    [this.still, this.stillView] = [still, this.view];
    this.image.after(still);
  }

  /** Show the poster of the manifest. */
  private async useOwn(): Promise<void> {
    const { manifest } = this.player;
    const poster = manifest?.presentation.poster;
    if (this.given || !manifest || !poster) return;
    const url = await addressOf(manifest, poster).catch(() => "");
    if (isSameReel(manifest, this.player.manifest) && !this.given) this.show(url);
  }

  private show(url: string): void {
    const over = this.player.playback.hasPicture;
    if (url && !over && this.image.src !== url) this.image.src = url;
    this.image.hidden = !url || over;
    this.image.style.objectPosition = this.given ? "" : `${this.position}% 50%`;
  }

  /** Horizontal position at which the poster covers the canvas as the first view does, in percent. */
  private get position(): number {
    const {
      camera,
      manifest,
      canvas: { clientWidth, clientHeight },
    } = this.player;
    if (!camera || !manifest) return 50;
    const { width, height } = manifest.camera;
    const [shown, whole] = [clientWidth / 2, (clientHeight * width) / height];
    return whole > clientWidth
      ? Math.min(Math.max((camera.center * whole - shown) / (whole - clientWidth), 0), 1) * 100
      : 50;
  }

  /** Show nothing. */
  private clear(): void {
    this.hide();
    this.blank(true);
  }

  /** Hide or show the canvas, which is black before the first frame. */
  private blank(on: boolean): void {
    this.player.canvas.classList.toggle("blank", on);
  }

  /** Uncover the canvas once the frame is complete or people moved the camera, and of another view or time once most of it is drawn. */
  private drawn(): void {
    this.blank(false);
    if (this.image.hidden && !this.still) return;
    const { playback, camera } = this.player;
    if (playback.ready || this.view !== this.stillView) this.removeStill();
    if (playback.ready || camera?.touched || (playback.isMostlyStatic && !this.matches)) this.fade();
  }

  private get view(): string {
    return String(this.player.camera?.viewmat);
  }

  /** True while the poster shows the present view and time. */
  private get matches(): boolean {
    const { camera, currentTime, earliest } = this.player;
    return this.given !== "" || (camera?.atOwnView === true && currentTime === earliest);
  }

  private fade(): void {
    if (this.image.hidden || this.fading) return;
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.fading = this.image.animate({ opacity: 0 }, calm ? 0 : FADE);
    this.fading.onfinish = () => this.hide();
  }

  private hide(): void {
    this.image.hidden = true;
    this.fading?.cancel();
    this.fading = null;
    this.removeStill();
  }

  private removeStill(): void {
    this.still?.remove();
    this.still = null;
  }
}
