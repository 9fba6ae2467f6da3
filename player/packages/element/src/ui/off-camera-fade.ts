/** Fades views far from those of the cameras to the background, with an explanation. */
import type { Player } from "../player/player";
import { elementOf } from "./markup";

/** Fade above which the explanation is shown. */
const WORDS = 0.05;

/** Overlay of one player. */
export class OffCameraFade {
  readonly box = elementOf(`<div class="beyond"><p role="status"></p></div>`);
  private shown = 0;

  constructor(private readonly player: Player) {
    player.addEventListener("drawn", () => this.update());
    player.addEventListener("emptied", () => this.update());
  }

  private update(): void {
    const { camera, canvas, manifest, transparent } = this.player;
    const fade = camera?.offCameraFade ?? 0;
    if (fade === this.shown) return;
    this.shown = fade;
    const color = (manifest?.background ?? [0, 0, 0]).map((part) => Math.round(255 * part));
    this.box.style.backgroundColor = transparent ? "" : `rgb(${color.join(" ")} / ${fade.toFixed(3)})`;
    canvas.style.opacity = transparent && fade > 0 ? (1 - fade).toFixed(3) : "";
    const words = fade > WORDS ? this.player.words("No camera looked from here") : "";
    const line = this.box.firstElementChild!;
    if (line.textContent !== words) line.textContent = words;
  }
}
