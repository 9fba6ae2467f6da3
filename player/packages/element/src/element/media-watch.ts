/** Loads the media session, a part on demand, at the first playback. */
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";

/** Show what a player plays on lock screens, until the signal. poster: image of the present reel. */
export function watchMedia(host: HTMLElement, player: Player, poster: HTMLImageElement, signal: AbortSignal): void {
  const { mediaSession } = navigator;
  if (!mediaSession) return;
  player.addEventListener(
    "playing",
    () => {
      const loading = loadPart("media-controls.js", () => import("../ui/media-controls"));
      // Playback goes on without it.
      loading.then(
        ({ MediaControls }) => void (signal.aborted || new MediaControls(host, player, poster, mediaSession, signal)),
        () => undefined,
      );
    },
    { once: true, signal },
  );
}
