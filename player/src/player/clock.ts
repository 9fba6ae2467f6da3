/** The time of the reel that is open: it runs while playing, and ends or begins again at the end. */
import type { Manifest } from "../reel/manifest";
import { firstFrameOf, momentAt, type Moment } from "../reel/timeline";

export class Clock {
  private reel: Manifest | null = null;
  private now = 0;
  private running = false;
  private speed = 1;
  private loops = false;

  /** Of the reel that is open; null: there is none yet. */
  get manifest(): Manifest | null {
    return this.reel;
  }

  get seconds(): number {
    return this.now;
  }

  get playing(): boolean {
    return this.running;
  }

  get loop(): boolean {
    return this.loops;
  }

  set loop(loop: boolean) {
    this.loops = loop;
  }

  get rate(): number {
    return this.speed;
  }

  set rate(rate: number) {
    this.speed = Math.min(Math.max(rate, 0), 16);
  }

  /** Where the reel begins, seconds: what was before may have been dropped. */
  get earliest(): number {
    return this.reel && this.reel.groups.length > 0 ? firstFrameOf(this.reel, this.reel.first)! / this.reel.fps : 0;
  }

  /** Where it ends, seconds; of a live reel, what there is so far. */
  get duration(): number {
    return this.reel ? this.reel.frames / this.reel.fps : 0;
  }

  get live(): boolean {
    return this.reel?.live === true;
  }

  /** Where a live reel is joined: the beginning of its last group. */
  get edge(): number {
    return this.reel ? this.reel.groups.at(-1)!.firstFrame / this.reel.fps : 0;
  }

  get ended(): boolean {
    return this.duration > 0 && !this.live && this.now >= this.duration;
  }

  /** The frame of the video that shows; the last one stays on until the end of its own duration. */
  get frame(): number {
    const { fps, frames } = this.reel!;
    return Math.min(this.now * fps, Math.max(frames - 1, 0));
  }

  /** What shows; null: a page that says so is not here. */
  get moment(): Moment | null {
    const { fps } = this.reel!;
    return momentAt(this.reel!, fps, this.frame / fps);
  }

  /** Keep the time of a reel, or, as a live one grows, of what it has become. The time stays. */
  update(manifest: Manifest): void {
    this.reel = manifest;
  }

  /** There is no reel for a while: time stays, and runs on with the next. */
  forget(): void {
    this.reel = null;
  }

  /** There is no reel any more: time is 0 and stands still. */
  reset(): void {
    [this.reel, this.running, this.now] = [null, false, 0];
  }

  start(): void {
    this.running = true;
  }

  stop(): void {
    this.running = false;
  }

  /** Go to a time, kept within the reel. */
  seek(seconds: number): void {
    this.now = Math.min(Math.max(seconds, this.earliest), this.duration);
  }

  /** The time some frames on or back, in whole frames. */
  framesOn(frames: number): number {
    const { fps, frames: total } = this.reel!;
    return Math.max(Math.min(Math.round(this.frame) + frames, total - 1) / fps, this.earliest);
  }

  /** Let seconds pass; false where time stands still. */
  advance(seconds: number): boolean {
    const { earliest, duration, live, loops } = this;
    if (live && !loops && this.now >= duration) return false; // wait at the edge
    this.now += seconds * this.speed;
    if (this.now >= duration) {
      // Until more of a live reel is there, its last group goes round.
      if (loops) this.now = live ? this.edge : earliest + ((this.now - earliest) % (duration - earliest));
      else this.now = duration;
    }
    return true;
  }
}
