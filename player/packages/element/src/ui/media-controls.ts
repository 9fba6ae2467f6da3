/** Media Session: title and poster on lock screens and media keys. This part is loaded on demand. */
import type { Player } from "../player/player";

/** Seconds of a step by a media key. */
const STEP = 10;

/** The element whose reel the session shows; the last one that played. */
let owner: MediaControls | null = null;

function setOwner(next: MediaControls | null): void {
  owner = next;
}

/** The media session of one element. */
export class MediaControls {
  /** poster: image of the present reel. */
  constructor(
    private readonly host: HTMLElement,
    private readonly player: Player,
    private readonly poster: HTMLImageElement,
    private readonly session: MediaSession,
    signal: AbortSignal,
  ) {
    player.addEventListener("play", () => this.take(), { signal });
    for (const name of ["playing", "pause", "seeked", "ratechange", "durationchange"])
      player.addEventListener(name, () => this.update(), { signal });
    player.addEventListener("loadedmetadata", () => owner === this && this.take(), { signal });
    player.addEventListener("emptied", () => this.release(), { signal });
    signal.addEventListener("abort", () => this.release());
    if (!player.paused) this.take();
  }

  /** Show this reel in the session. */
  private take(): void {
    const { player, session } = this;
    setOwner(this);
    const { title = "", author: artist = "" } = player.manifest?.presentation ?? {};
    const name = title || (this.host.getAttribute("aria-label") ?? document.title);
    session.metadata = new MediaMetadata({
      title: name,
      artist,
      artwork: this.poster.src ? [{ src: this.poster.src }] : [],
    });
    this.handle({
      play: () => player.play(),
      pause: () => player.pause(),
      stop: () => player.pause(),
      seekbackward: ({ seekOffset }) => void (player.currentTime -= seekOffset ?? STEP),
      seekforward: ({ seekOffset }) => void (player.currentTime += seekOffset ?? STEP),
      seekto: ({ seekTime }) => void (player.currentTime = seekTime ?? player.currentTime),
      previoustrack: player.tracks?.chapters.length ? () => player.tracks?.step(-1) : null,
      nexttrack: player.tracks?.chapters.length ? () => player.tracks?.step(1) : null,
    });
    this.update();
  }

  private update(): void {
    const { player, session } = this;
    if (owner !== this) return;
    session.playbackState = player.paused ? "paused" : "playing";
    const { duration, currentTime, playbackRate } = player;
    if (duration > 0 && playbackRate > 0)
      session.setPositionState?.({ duration, position: Math.min(currentTime, duration), playbackRate });
  }

  /** Give the session back. */
  private release(): void {
    if (owner !== this) return;
    setOwner(null);
    this.session.metadata = null;
    this.session.playbackState = "none";
    this.handle({
      play: null,
      pause: null,
      stop: null,
      seekbackward: null,
      seekforward: null,
      seekto: null,
      previoustrack: null,
      nexttrack: null,
    });
  }

  private handle(handlers: Partial<Record<MediaSessionAction, MediaSessionActionHandler | null>>): void {
    for (const [action, handler] of Object.entries(handlers)) {
      try {
        this.session.setActionHandler(action as MediaSessionAction, handler);
      } catch {
        // The browser lacks this action.
      }
    }
  }
}
