/** Mute button and volume slider of the bar. */
import type { Player } from "../player/player";
import { MUTED, SOUND } from "./icons";
import { elementOf } from "./markup";

const MARKUP = `<div class="volume" hidden>
  <button type="button" class="mute" aria-label="Mute" hidden>${SOUND}</button>
  <input class="level" type="range" min="0" max="1" step="0.05" aria-label="Volume" />
</div>`;

/** Keys that the slider handles. Elsewhere they control time, view or focus. Left and right go to the buttons beside it. */
const KEYS = ["ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];

/** The volume control of one player; hidden for a silent reel. */
export class VolumeControl {
  readonly box: HTMLElement;
  private readonly button: HTMLButtonElement;
  private readonly slider: HTMLInputElement;

  constructor(private readonly player: Player) {
    this.box = elementOf(MARKUP, player.words);
    this.button = this.box.querySelector(".mute")!;
    this.slider = this.box.querySelector(".level")!;
    const { button, slider } = this;
    button.onclick = () => player.soundtrack.toggle();
    slider.addEventListener("input", () => {
      player.soundtrack.volume = Number(slider.value);
      player.soundtrack.muted = false;
    });
    slider.addEventListener("keydown", (event) => KEYS.includes(event.key) && event.stopPropagation());
  }

  /** Show the present state. */
  update(): void {
    const { button, slider } = this;
    const { available, muted, volume } = this.player.soundtrack;
    this.box.hidden = button.hidden = !available;
    const silent = muted || volume === 0;
    const label = this.player.words(silent ? "Unmute" : "Mute");
    if (button.title !== `${label} (m)`) {
      button.replaceChildren(elementOf(silent ? MUTED : SOUND));
      button.setAttribute("aria-label", label);
      button.title = `${label} (m)`;
    }
    slider.value = String(muted ? 0 : volume);
    slider.setAttribute("aria-valuetext", `${Math.round(100 * Number(slider.value))} %`);
  }
}
