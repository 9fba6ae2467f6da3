/**
 * Prompt on the first visit that people can look around. It lies below the middle of the picture, else at its top, where it covers
 * nothing else, and waits while there is no such place. It disappears after the first gesture or some seconds.
 */
import type { Player } from "../player/player";
import type { CooperativeGestures } from "./cooperative-gestures";
import { HAND } from "./icons";
import { elementOf } from "./markup";

/** Key in the page's storage that marks returning visitors. */
const KNOWN = "splatreel-knows-gestures";

/** Parts of the player that the prompt must not cover. */
const OTHERS =
  ".start, .unmute, .spinner, .wait.long p, .toast.shown, .sheet, .choices, .bar > *, .cue, .beyond p, .annotation, .path-drawing, .walk, .gestures.shown";
/** Minimum distance to them, in pixels. */
const GAP = 4;

/** Shows the prompt once. */
export class FirstPrompt {
  private readonly box = elementOf(`<div class="prompt" aria-hidden="true">${HAND}<p></p></div>`);

  /** Show the prompt once the first frame is drawn, until the signal. root: of the element. */
  constructor(
    private readonly root: ShadowRoot,
    private readonly player: Player,
    gestures: CooperativeGestures,
    signal: AbortSignal,
  ) {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches || isKnown()) return;
    const { box } = this;
    const finger = !gestures.active && matchMedia("(pointer: coarse)").matches;
    const remove = (): void => box.remove();
    const show = (): void => {
      if (isKnown() || this.used) return;
      remember();
      box.lastElementChild!.textContent = player.words(
        finger ? "Use two fingers to look around" : "Drag to look around",
      );
      gestures.hint.after(box);
      this.place();
    };
    box.addEventListener("animationend", ({ target }) => target === box && remove());
    player.addEventListener("canplay", show, { once: true, signal });
    player.addEventListener("drawn", () => this.used && (remember(), remove()), { signal });
    for (const name of ["error", "emptied"]) player.addEventListener(name, remove, { signal });
    signal.addEventListener("abort", remove);
  }

  /** Move the prompt to a free place in each display frame, or hide it. */
  private place(): void {
    const { box } = this;
    if (!box.isConnected) return;
    requestAnimationFrame(() => this.place());
    if (this.isFree) return box.classList.remove("away");
    box.classList.toggle("high");
    box.classList.toggle("away", !this.isFree);
  }

  /** True if the prompt lies on the picture and covers no other part. */
  private get isFree(): boolean {
    const { left, top, right, bottom } = this.box.getBoundingClientRect();
    const picture = this.player.canvas.getBoundingClientRect();
    if (left < picture.left || top < picture.top || right > picture.right || bottom > picture.bottom) return false;
    return [...this.root.querySelectorAll(OTHERS)].every((other) => {
      const box = other.getBoundingClientRect(); // empty if it is not shown
      return (
        box.width === 0 ||
        box.left >= right + GAP ||
        box.right <= left - GAP ||
        box.top >= bottom + GAP ||
        box.bottom <= top - GAP
      );
    });
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
