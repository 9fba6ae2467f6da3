/** Promises of `play()`, settled as in HTMLMediaElement. */
import type { PlayerCore } from "./player-core";

interface Promised {
  resolve(): void;
  reject(error: DOMException): void;
}

/** Pending promises of one player. */
export class PlayPromises {
  private waiting: Promised[] = [];

  /** start: starts to play. */
  constructor(
    private readonly player: PlayerCore,
    private readonly start: () => void,
  ) {
    player.addEventListener("playing", () => this.settle((promised) => promised.resolve()));
    player.addEventListener("notallowed", () =>
      this.fail(
        "NotAllowedError",
        "The browser allows sound only after an interaction with the page. Mute the reel, or call play() in a click handler.",
      ),
    );
    player.addEventListener("pause", () => this.fail("AbortError", "play() was interrupted by a call to pause()."));
    player.addEventListener("emptied", () =>
      this.fail("AbortError", "play() was interrupted: another reel is opened, or none."),
    );
    player.addEventListener("error", () => this.fail("NotSupportedError", player.error!.message));
  }

  /** Play. Resolves once time advances. Rejects with an `AbortError`, `NotSupportedError` or `NotAllowedError`. */
  play(): Promise<void> {
    const { player } = this;
    if (!player.hasSource)
      return Promise.reject(new DOMException("There is no reel to play: its address is missing.", "NotSupportedError"));
    if (player.error) return Promise.reject(new DOMException(player.error.message, "NotSupportedError"));
    this.start();
    if (player.playback.advancing) return Promise.resolve();
    return new Promise((resolve, reject) => this.waiting.push({ resolve, reject }));
  }

  private fail(name: string, why: string): void {
    this.settle((promised) => promised.reject(new DOMException(why, name)));
  }

  private settle(each: (promised: Promised) => void): void {
    const { waiting } = this;
    this.waiting = [];
    waiting.forEach(each);
  }
}
