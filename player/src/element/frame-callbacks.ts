/** `requestVideoFrameCallback`: has a page told of each picture that is drawn. */
import type { Player } from "../player/player";

/** As that of HTMLVideoElement. Sizes in pixels, `mediaTime` in seconds of the reel. */
export interface FrameMetadata {
  presentationTime: number;
  expectedDisplayTime: number;
  width: number;
  height: number;
  mediaTime: number;
  presentedFrames: number;
}

export type FrameCallback = (now: number, metadata: FrameMetadata) => void;

export class FrameCallbacks {
  private waiting = new Map<number, FrameCallback>();
  private handles = 0;
  private pictures = 0;

  constructor(private readonly player: Player) {
    player.addEventListener("drawn", () => this.tell());
  }

  /** Call once, with the next picture. Returns a handle for `cancel`. */
  request(callback: FrameCallback): number {
    this.waiting.set(++this.handles, callback);
    return this.handles;
  }

  cancel(handle: number): void {
    this.waiting.delete(handle);
  }

  private tell(): void {
    this.pictures++;
    const { waiting, player: { canvas: { width, height }, currentTime, resolution } } = this;
    if (waiting.size === 0) return;
    this.waiting = new Map();
    const now = performance.now();
    const metadata = { presentationTime: now, expectedDisplayTime: now + resolution.interval, width, height, mediaTime: currentTime, presentedFrames: this.pictures };
    for (const callback of waiting.values()) {
      try {
        callback(now, metadata);
      } catch (error) {
        reportError(error);
      }
    }
  }
}
