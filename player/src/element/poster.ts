/** Image over the canvas until the reel is drawn: the poster, or the last frame of a reel that rests or has lost its device. */
import { DeviceLostError } from "@splatreel/decoder/base/errors";
import type { Player } from "../player/player";
import { addressOf, isSameReel } from "@splatreel/decoder/reel/manifest";
import { LastPicture } from "./last-picture";

/** Shows and hides the poster and the last frame. */
export class Poster {
  readonly image = document.createElement("img");
  private still: HTMLCanvasElement | null = null;
  /** Address given by the page, which takes precedence over the manifest's. */
  private given = "";
  private readonly last: LastPicture;

  constructor(private readonly player: Player) {
    const { image } = this;
    this.last = new LastPicture(player);
    image.className = "poster";
    image.alt = "";
    image.fetchPriority = "high";
    player.addEventListener("loadedmetadata", () => void this.useOwn());
    player.addEventListener("loadeddata", () => this.drawn());
    player.addEventListener("canplay", () => this.hide());
    player.addEventListener("emptied", () => this.clear());
    player.addEventListener("error", () => this.player.error instanceof DeviceLostError && this.last.canvas && this.showStill(this.last.canvas));
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
    this.still = still;
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

  /** Hide the poster once the reel is drawn, or its static points if they are most of it. */
  private drawn(): void {
    this.blank(false);
    if (this.player.playback.ready || this.player.playback.isMostlyStatic) this.hide();
  }

  private hide(): void {
    this.image.hidden = true;
    this.still?.remove();
    this.still = null;
  }
}
