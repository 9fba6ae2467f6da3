/** Thumbnails of the seek bar, from sheets that are loaded on demand, as is this part. */
import type { Player } from "../player/player";
import { addressOf, type Asset, type Manifest, type Thumbnails as Sheets } from "@splatreel/decoder/internal";
import { elementOf } from "./markup";
import { scaleOf } from "./pointer-controls";

/** Maximum size in CSS pixels, and maximum height relative to the picture. */
const WIDTH = 160;
const HEIGHT = 100;
const SHARE = 0.38;
/** Minimum distance to the upper edge of the picture, and minimum height, in CSS pixels. */
const GAP = 4;
const SHORTEST = 24;

/** The thumbnail of one seek bar. */
export class Thumbnails {
  readonly box = elementOf(`<span class="thumbnail" hidden><img alt="" /></span>`);
  private readonly image = this.box.querySelector("img")!;
  /** Address of the present sheet. */
  private uri = "";

  constructor(private readonly player: Player) {
    this.image.onload = () => (this.image.hidden = false);
    this.image.onerror = () => (this.uri = ""); // retry on the next use
  }

  /** Show the thumbnail nearest to a time in seconds, if the reel has any. */
  show(seconds: number): void {
    const { manifest } = this.player;
    const sheets = manifest?.presentation.thumbnails;
    this.box.hidden = !sheets;
    if (manifest && sheets)
      this.place(manifest, sheets, Math.min(Math.round(seconds / sheets.seconds), sheets.count - 1));
  }

  private place(manifest: Manifest, { width, height, columns, rows, sheets }: Sheets, index: number): void {
    const { box, image } = this;
    const most = this.space;
    box.hidden = most < SHORTEST;
    const dp = this.pixel;
    const scale = Math.min(dp, (dp * WIDTH) / width, Math.min(dp * HEIGHT, most) / height);
    const at = index % (columns * rows);
    Object.assign(box.style, { width: `${width * scale}px`, height: `${height * scale}px` });
    image.style.width = `${columns * width * scale}px`;
    image.style.translate = `${-(at % columns) * width * scale}px ${-Math.floor(at / columns) * height * scale}px`;
    this.open(manifest, sheets[Math.floor(index / (columns * rows))]);
  }

  /** Length that grows with the element (ui.css), in CSS pixels. */
  private get pixel(): number {
    return Number.parseFloat(getComputedStyle(this.box).getPropertyValue("--splatreel-dp"));
  }

  /** Maximum height above the texts of the hint, whose lower edge stays in place. */
  private get space(): number {
    const {
      box,
      player: { canvas },
    } = this;
    const hint = box.parentElement!;
    const texts = hint.offsetHeight - box.offsetHeight;
    const above = (hint.getBoundingClientRect().bottom - canvas.getBoundingClientRect().top) / scaleOf(canvas);
    return Math.min(SHARE * canvas.clientHeight, above - texts - GAP);
  }

  private open(manifest: Manifest, sheet: Asset): void {
    const { image } = this;
    const uri = manifest.url + sheet.uri;
    if (this.uri === uri) return;
    this.uri = uri;
    image.hidden = true;
    void addressOf(manifest, sheet).then(
      (address) => this.uri === uri && (image.src = address),
      () => undefined,
    );
  }
}
