/** `requestVideoFrameCallback`: reports each drawn frame to the page. */
import type { Player } from "../player/player";

/** Metadata of a frame, as in HTMLVideoElement. Sizes are in pixels, `mediaTime` in seconds of the reel. */
export interface FrameMetadata {
  presentationTime: number;
  expectedDisplayTime: number;
  width: number;
  height: number;
  mediaTime: number;
  presentedFrames: number;
}

/** Function that receives the next frame. */
export type FrameCallback = (now: number, metadata: FrameMetadata) => void;

/** Pending callbacks of one element. */
export class FrameCallbacks {
  private waiting = new Map<number, FrameCallback>();
  private handles = 0;
  private pictures = 0;

  constructor(private readonly player: Player) {
    player.addEventListener("drawn", () => this.report());
  }

  /** Call a function once, with the next frame. Returns a handle for `cancel`. */
  request(callback: FrameCallback): number {
    this.waiting.set(++this.handles, callback);
    return this.handles;
  }

  cancel(handle: number): void {
    this.waiting.delete(handle);
  }

  private report(): void {
    this.pictures++;
    const {
      waiting,
      player: {
        canvas: { width, height },
        currentTime,
        resolution,
      },
    } = this;
    if (waiting.size === 0) return;
    this.waiting = new Map();
    const now = performance.now();
    const metadata = {
      presentationTime: now,
      expectedDisplayTime: now + resolution.interval,
      width,
      height,
      mediaTime: currentTime,
      presentedFrames: this.pictures,
    };
    for (const callback of waiting.values()) {
      try {
        callback(now, metadata);
      } catch (error) {
        reportError(error);
      }
    }
  }
}
