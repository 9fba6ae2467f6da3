/** Shows the controls while the pointer moves or playback is paused, and on touch screens by a tap on the picture. */
import type { Player } from "../player/player";
import type { HostWithStates } from "./host-states";

/** Milliseconds without a move after which the controls fade during playback. */
const FADE_AFTER = 2600;

/** Sets and clears the state `idle` of the host. */
export class AutoHide {
  private fade = 0;
  private touched = false;

  /** holder: element of all controls. busy: returns true while they are in use. */
  constructor(
    private readonly host: HostWithStates,
    private readonly holder: HTMLElement,
    private readonly player: Player,
    private readonly busy: () => boolean,
    signal: AbortSignal,
  ) {
    const { canvas } = player;
    for (const name of ["pointermove", "pointerdown"] as const)
      host.addEventListener(name, (event) => this.pointer(event), { signal });
    // Ignore focus by click or tap.
    host.addEventListener(
      "focusin",
      (event) => (event.composedPath()[0] as Element).matches(":focus-visible") && this.wake(),
      { signal },
    );
    host.addEventListener("pointerleave", (event) => event.pointerType !== "touch" && this.sleep(), { signal });
    // The click follows the tap, so that it does not reach the controls that it shows.
    canvas.addEventListener("click", () => this.touched && (this.asleep ? this.wake() : this.sleep()), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.fade));
  }

  /** Keep the controls visible while paused. */
  update(): void {
    const { paused, error } = this.player;
    if (paused || error) this.host.states.toggle("idle", false);
    else if (!this.fade) this.wake();
  }

  /** Show the controls for a while. */
  wake(): void {
    this.host.states.toggle("idle", false);
    clearTimeout(this.fade);
    this.fade = window.setTimeout(() => this.sleep(), FADE_AFTER);
  }

  private get asleep(): boolean {
    return this.host.states.has("idle");
  }

  private pointer(event: PointerEvent): void {
    this.touched = event.pointerType === "touch";
    if (!this.touched || event.composedPath().includes(this.holder)) this.wake();
  }

  private sleep(): void {
    const { player, holder, host } = this;
    if (player.paused || player.error || this.busy() || holder.matches(":has(:focus-visible)")) return;
    // Hidden controls must not keep the focus.
    if (holder.matches(":has(.bar :focus)")) player.canvas.focus({ preventScroll: true });
    host.states.toggle("idle", true);
  }
}
