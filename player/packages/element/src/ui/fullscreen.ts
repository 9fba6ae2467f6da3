/** Fullscreen, or the whole window if the browser does not allow fullscreen. */
import type { HostWithStates } from "./host-states";

/** Fullscreen state of one element. */
export class Fullscreen {
  /** changed: called when the state changes. */
  constructor(
    private readonly host: HostWithStates,
    private readonly changed: () => void,
    signal: AbortSignal,
  ) {
    document.addEventListener("fullscreenchange", changed, { signal });
  }

  get on(): boolean {
    return document.fullscreenElement !== null || this.host.states.has("filling");
  }

  /** Label of the button; "" if it would have no effect. */
  get offer(): string {
    if (document.fullscreenElement) return "Leave fullscreen";
    if (document.fullscreenEnabled) return "Fullscreen";
    if (this.on) return "Exit full window";
    const { clientWidth, clientHeight } = this.host;
    return clientWidth < innerWidth - 1 || clientHeight < innerHeight - 1 ? "Fill the window" : "";
  }

  /** Rejects where the browser refuses. */
  async toggle(): Promise<void> {
    if (document.fullscreenElement) await document.exitFullscreen();
    else if (document.fullscreenEnabled) await this.host.requestFullscreen();
    else if (this.offer) this.host.states.toggle("filling");
    this.changed();
  }

  /** Give the window back. Returns false if the element does not fill it. */
  leave(): boolean {
    if (!this.host.states.has("filling")) return false;
    this.host.states.toggle("filling", false);
    this.changed();
    return true;
  }
}
