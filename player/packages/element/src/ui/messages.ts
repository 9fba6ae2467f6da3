/** Messages in the center of the picture: loading, first play, errors, toasts. */
import { plainWords } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";
import type { Soundtrack } from "@splatreel/renderer";
import { MUTED, PLAY } from "./icons";
import { elementOf } from "./markup";

/** Pixels above which a move is a drag. */
const DRAG = 6;

/** Pass the gestures that begin on a button on to the surface below. */
function passGestures(button: HTMLElement, surface: HTMLElement): void {
  /** Pressed pointers that have not moved, by id. */
  const resting = new Map<number, PointerEvent>();
  let dragged = false;
  const pass = (): void => {
    dragged = true;
    // The surface captures these pointers and receives their further events.
    for (const event of resting.values()) surface.dispatchEvent(new PointerEvent("pointerdown", event));
    resting.clear();
  };
  button.addEventListener("pointerdown", (event) => {
    if (resting.size === 0) dragged = false;
    resting.set(event.pointerId, event);
    if (resting.size > 1 || event.button !== 0) pass();
  });
  button.addEventListener("pointermove", (event) => {
    const began = resting.get(event.pointerId);
    if (!began || Math.hypot(event.clientX - began.clientX, event.clientY - began.clientY) <= DRAG) return;
    pass();
    surface.dispatchEvent(new PointerEvent("pointermove", event));
  });
  for (const name of ["pointerup", "pointercancel", "pointerleave"] as const)
    button.addEventListener(name, ({ pointerId }) => resting.delete(pointerId));
  button.addEventListener("click", (event) => dragged && event.stopImmediatePropagation(), { capture: true });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener(
    "wheel",
    (event) => {
      if (!surface.dispatchEvent(new WheelEvent("wheel", event))) event.preventDefault();
    },
    { passive: false },
  );
}

/** Milliseconds after which a wait is explained. */
const EXPLAIN_AFTER = 900;
/** Milliseconds for which a toast is shown, in total and per letter; the longer time counts. */
const TOAST = 2200;
const TOAST_PER_LETTER = 60;

const MARKUP = `<div class="center">
  <div class="wait" role="status" hidden><div class="spinner"></div><p>Loading</p></div>
  <button class="start" type="button" aria-label="Start the reel" tabindex="-1" hidden>${PLAY}</button>
  <button class="unmute" type="button" hidden>${MUTED}Tap for sound</button>
  <div class="toast" role="status"></div>
  <div class="sheet panel" role="alert" hidden>
    <h2></h2>
    <p></p>
    <button type="button" class="retry">Try again</button>
    <details><summary>Details</summary><div></div></details>
  </div>
</div>`;

/** The messages of one player. */
export class Messages {
  readonly box: HTMLElement;
  private explain = 0;
  private toast = 0;
  /** Error of the sound that was shown last. */
  private reported: Error | null = null;

  constructor(private readonly player: Player) {
    this.box = elementOf(MARKUP, player.words);
    for (const name of [".start", ".unmute"]) passGestures(this.find(name), player.canvas);
    this.find(".start").onclick = () => player.play();
    this.find(".retry").onclick = () => player.retry();
    this.find(".unmute").onclick = () => player.soundtrack.toggle();
  }

  /** Show the present state. */
  update(): void {
    const { canPlay, paused, currentTime, earliest, error, waiting, busy, deferred, hasSource, soundtrack } =
      this.player;
    this.updatePanel(error);
    this.updateWait(busy && (!canPlay || waiting));
    this.updateSound(soundtrack, paused);
    const begins = canPlay ? currentTime === earliest && !waiting : deferred && hasSource && !busy;
    this.find(".start").hidden = !(begins && paused && !error);
  }

  private updateSound({ blocked, error }: Soundtrack, paused: boolean): void {
    this.find(".unmute").hidden = !blocked || paused;
    if (error && error !== this.reported) this.say(this.player.words("The sound cannot be played"));
    this.reported = error;
  }

  /** Show a toast; "" to hide it. */
  say(text: string): void {
    const box = this.find(".toast");
    if (text) box.textContent = text;
    box.classList.toggle("shown", text !== "");
    clearTimeout(this.toast);
    this.toast = window.setTimeout(
      () => box.classList.remove("shown"),
      Math.max(TOAST, TOAST_PER_LETTER * text.length),
    );
  }

  /** Show an error in plain words, with the exact message in the details. */
  private updatePanel(error: Error | null): void {
    const panel = this.find(".panel");
    if (error && panel.hidden) {
      const t = this.player.words;
      const plain = t(plainWords(error));
      this.find(".panel h2").textContent = t(this.player.canPlay ? "Playback stopped" : "This reel cannot be played");
      this.find(".panel p").textContent = plain;
      const details = this.box.querySelector("details")!;
      [details.hidden, details.open] = [plain === error.message, false];
      this.find("details div").textContent = error.message;
    }
    panel.hidden = !error;
  }

  /** Show the spinner at once, and text after a while. */
  private updateWait(waiting: boolean): void {
    const wait = this.find(".wait");
    if (waiting && wait.hidden) {
      wait.classList.remove("long");
      this.explain = window.setTimeout(() => wait.classList.add("long"), EXPLAIN_AFTER);
    }
    if (!waiting) clearTimeout(this.explain);
    wait.hidden = !waiting;
    const { notice, progress, words: t } = this.player;
    const text =
      notice !== null ? t(notice) : progress > 0 ? t("Loading {0} %", Math.floor(100 * progress)) : t("Loading");
    const words = wait.querySelector("p")!;
    if (words.textContent !== text) words.textContent = text;
  }

  private find(name: string): HTMLElement {
    return this.box.querySelector<HTMLElement>(name)!;
  }
}
