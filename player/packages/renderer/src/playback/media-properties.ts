/** Properties and methods of HTMLMediaElement for the objects of other engines, which share no base class. */
import { type Class, propertiesOf } from "../base/delegation";
import type { ReelPlayer } from "./reel-player";

/** Return a subclass with properties and methods of a media element, which its field `player` has. */
export function withMediaProperties<Base extends Class>(base: Base) {
  const Delegating = propertiesOf<ReelPlayer>("player")(
    base as Class,
    ["paused", "duration", "ended", "seeking", "waiting", "canPlay", "error", "renditions", "points", "background"],
    ["currentTime", "loop", "playbackRate", "muted", "volume", "positional", "rendition"],
  );
  abstract class MediaObject extends Delegating {
    /** Time, sound and files of the reel. It may change between versions. */
    abstract readonly player: ReelPlayer;

    /**
     * Start to play. Browsers require an interaction before sound; until then the reel is muted, and `muted` is true. Resolves once
     * time advances. Rejects with `AbortError` if it is paused before, and with `NotSupportedError` if the reel cannot be played.
     */
    play(): Promise<void> {
      return this.player.play();
    }

    pause(): void {
      this.player.pause();
    }

    /** Resolve once a complete frame has been drawn; reject on an error, and after the object was disposed of. */
    async whenReady(): Promise<this> {
      await this.player.whenReady();
      return this;
    }
  }
  return MediaObject as Base & typeof MediaObject;
}
