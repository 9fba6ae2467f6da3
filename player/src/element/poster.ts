/** The picture over the canvas until the reel's own is there: the poster, or, of a reel that was put to rest or whose graphics device is lost, what it showed last. */
import { DeviceLostError } from "../base/errors";
import type { Player } from "../player/player";
import { addressOf, isSameReel } from "../reel/manifest";
import { LastPicture } from "./last-picture";

export class Poster {
  readonly image = document.createElement("img");
  private still: HTMLCanvasElement | null = null;
  /** Given by the page; goes before the reel's own. */
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

  /** Show a picture of the page, or none, until there is a picture of the reel. */
  give(url: string): void {
    this.given = url;
    this.show(url || this.player.prefetchedPoster);
    if (!url) void this.useOwn();
  }

  /** Keep what the canvas shows. */
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

  /** The one that the manifest names, which is small and wanted at once. */
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

  /** Nothing shows but the ground of the page. */
  private clear(): void {
    this.hide();
    this.blank(true);
  }

  /** A canvas on which nothing was drawn is black. */
  private blank(on: boolean): void {
    this.player.canvas.classList.toggle("blank", on);
  }

  /** What rests is drawn: it takes the poster's place where it is most of the picture. */
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
