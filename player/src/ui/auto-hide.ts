/** When the controls show: while something moves or waits, and on touch screens from one tap on the picture to the next. */
import type { Player } from "../player/player";

/** The controls fade after this many milliseconds without a move, while playing. */
const FADE_AFTER = 2600;

export class AutoHide {
  private fade = 0;
  private touched = false;

  /** holder: all controls; busy: whether they are in use and have to stay. */
  constructor(private readonly host: HTMLElement, private readonly holder: HTMLElement, private readonly player: Player, private readonly busy: () => boolean, signal: AbortSignal) {
    const { canvas } = player;
    for (const name of ["pointermove", "pointerdown"] as const) host.addEventListener(name, (event) => this.pointer(event), { signal });
    // Not by the focus that comes with a click or a tap.
    host.addEventListener("focusin", (event) => (event.composedPath()[0] as Element).matches(":focus-visible") && this.wake(), { signal });
    host.addEventListener("pointerleave", (event) => event.pointerType !== "touch" && this.sleep(), { signal });
    // A tap becomes a click once it is over: what it brings up does not get it.
    canvas.addEventListener("click", () => this.touched && (this.asleep ? this.wake() : this.sleep()), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.fade));
  }

  /** Show them while nothing plays. */
  update(): void {
    const { paused, error } = this.player;
    if (paused || error) this.host.classList.remove("idle");
    else if (!this.fade) this.wake();
  }

  /** Show them for a while. */
  wake(): void {
    this.host.classList.remove("idle");
    clearTimeout(this.fade);
    this.fade = window.setTimeout(() => this.sleep(), FADE_AFTER);
  }

  private get asleep(): boolean {
    return this.host.classList.contains("idle");
  }

  private pointer(event: PointerEvent): void {
    this.touched = event.pointerType === "touch";
    if (!this.touched || event.composedPath().includes(this.holder)) this.wake();
  }

  private sleep(): void {
    const { player, holder, host } = this;
    if (player.paused || player.error || this.busy() || holder.matches(":has(:focus-visible)")) return;
    // What does not show cannot have the keys.
    if (holder.matches(":has(.bar :focus)")) player.canvas.focus({ preventScroll: true });
    host.classList.add("idle");
  }
}
