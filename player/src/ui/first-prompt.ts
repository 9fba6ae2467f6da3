/** Prompt on the first visit that people can look around. It disappears after the first gesture or some seconds. */
import type { Player } from "../player/player";
import type { CooperativeGestures } from "./cooperative-gestures";
import { HAND } from "./icons";
import { elementOf } from "./markup";

/** Key in the page's storage that marks returning visitors. */
const KNOWN = "splatreel-knows-gestures";

/** Shows the prompt once. */
export class FirstPrompt {
  /** Show the prompt once the first frame is drawn, until the signal. */
  constructor(private readonly player: Player, gestures: CooperativeGestures, signal: AbortSignal) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches || isKnown()) return;
    const finger = !gestures.active && matchMedia("(pointer: coarse)").matches;
    const box = elementOf(`<div class="prompt" aria-hidden="true">${HAND}<p></p></div>`);
    const remove = (): void => box.remove();
    const show = (): void => {
      if (isKnown() || this.used) return;
      remember();
      box.lastElementChild!.textContent = player.words(finger ? "Use two fingers to look around" : "Drag to look around");
      gestures.hint.after(box);
    };
    box.addEventListener("animationend", ({ target }) => target === box && remove());
    player.addEventListener("canplay", show, { once: true, signal });
    player.addEventListener("drawn", () => this.used && (remember(), remove()), { signal });
    for (const name of ["error", "emptied"]) player.addEventListener(name, remove, { signal });
    signal.addEventListener("abort", remove);
  }

  /** True once people have moved the camera. */
  private get used(): boolean {
    return this.player.camera?.touched === true;
  }
}

/** Return true if the prompt was shown. Without storage, as in a sandboxed frame, this holds for the page only. */
function isKnown(): boolean {
  try {
    return localStorage.getItem(KNOWN) !== null;
  } catch {
    return document.documentElement.hasAttribute(`data-${KNOWN}`);
  }
}

function remember(): void {
  try {
    localStorage.setItem(KNOWN, "1");
  } catch {
    document.documentElement.setAttribute(`data-${KNOWN}`, "");
  }
}
