/** The time of the reel that is open: it runs while playing, and ends or begins again at the end. */
import type { Manifest } from "../reel/manifest";
import { momentAt, type Moment } from "../reel/timeline";

export class Clock {
  manifest: Manifest | null = null;
  seconds = 0;
  playing = false;
  loop = false;

  private speed = 1;

  /** Seconds; of a live reel, what there is so far. */
  get duration(): number {
    return this.manifest ? this.manifest.frames / this.manifest.fps : 0;
  }

  get live(): boolean {
    return this.manifest?.live === true;
  }

  /** Where a live reel is joined: the beginning of its last group. */
  get edge(): number {
    const { manifest } = this;
    return manifest ? manifest.groups.at(-1)!.firstFrame / manifest.fps : 0;
  }

  get ended(): boolean {
    return this.duration > 0 && !this.live && this.seconds >= this.duration;
  }

  get rate(): number {
    return this.speed;
  }

  set rate(rate: number) {
    this.speed = Math.min(Math.max(rate, 0), 16);
  }

  /** The frame of the video that shows; the last one stays on until the end of its own duration. */
  get frame(): number {
    const { fps, frames } = this.manifest!;
    return Math.min(this.seconds * fps, Math.max(frames - 1, 0));
  }

  get moment(): Moment {
    const { groups, overlap, fps } = this.manifest!;
    return momentAt(groups, overlap, fps, this.frame / fps);
  }

  /** Go to a time, kept within the reel. */
  seek(seconds: number): void {
    this.seconds = Math.min(Math.max(seconds, 0), this.duration);
  }

  /** The time some frames on or back, in whole frames. */
  framesOn(frames: number): number {
    const { fps, frames: total } = this.manifest!;
    return Math.min(Math.max(Math.round(this.frame) + frames, 0), total - 1) / fps;
  }

  /** Let seconds pass; false where time stands still. */
  advance(seconds: number): boolean {
    const { duration, live, loop } = this;
    if (live && !loop && this.seconds >= duration) return false; // wait at the edge
    this.seconds += seconds * this.speed;
    if (this.seconds >= duration) {
      // Until more of a live reel is there, its last group goes round.
      if (loop) this.seconds = live ? this.edge : this.seconds % duration;
      else this.seconds = duration;
    }
    return true;
  }
}
