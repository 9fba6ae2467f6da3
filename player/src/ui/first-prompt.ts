/** Tells people on their first visit that they can look around: once, until the first gesture or for some seconds. */
import type { Player } from "../player/player";
import type { CooperativeGestures } from "./cooperative-gestures";
import { HAND } from "./icons";
import { elementOf } from "./markup";

/** In the page's own storage: this visitor knows. */
const KNOWN = "splatreel-knows-gestures";

export class FirstPrompt {
  /** Show it over the picture of a player once that is there, until the signal. */
  constructor(private readonly player: Player, gestures: CooperativeGestures, signal: AbortSignal) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches || isKnown()) return;
    const finger = !gestures.active && matchMedia("(pointer: coarse)").matches;
    const box = elementOf(`<div class="prompt" aria-hidden="true">${HAND}<p>${finger ? "Use two fingers to look around" : "Drag to look around"}</p></div>`);
    const remove = (): void => box.remove();
    const show = (): void => {
      if (isKnown() || this.used) return;
      remember();
      gestures.hint.after(box);
    };
    box.addEventListener("animationend", ({ target }) => target === box && remove());
    player.addEventListener("canplay", show, { once: true, signal });
    player.addEventListener("drawn", () => this.used && (remember(), remove()), { signal });
    for (const name of ["error", "emptied"]) player.addEventListener(name, remove, { signal });
    signal.addEventListener("abort", remove);
  }

  /** Somebody has moved the view. */
  private get used(): boolean {
    return this.player.camera?.touched === true;
  }
}

/** Without storage, as in a sandboxed frame, it shows once in each page. */
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
