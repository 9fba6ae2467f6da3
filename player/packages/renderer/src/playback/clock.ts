/** Time of the open reel. It advances while playing, and stops or loops at the end. */
import { firstFrameOf, type Manifest, type Moment, momentAt, type Reel } from "@splatreel/decoder/internal";

/** Maps the time of playback to frames and groups. */
export class Clock {
  private current: Reel | null = null;
  private now = 0;
  private running = false;
  private speed = 1;
  private loops = false;
  private repeated: [number, number] | null = null;

  /** The open reel; null before its manifest arrives. */
  get reel(): Reel | null {
    return this.current;
  }

  /** Manifest of the open reel; null before it arrives. */
  get manifest(): Manifest | null {
    return this.current?.manifest ?? null;
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

  /** Part of the reel that repeats, [start, end] in seconds; null for none. */
  get section(): readonly [number, number] | null {
    return this.repeated;
  }

  /** Throws `TypeError` if the end does not come after the start. */
  set section(section: readonly [number, number] | null) {
    if (section && !(section[0] >= 0 && section[1] > section[0]))
      throw new TypeError(`A section must end after it starts, not last from ${section[0]} to ${section[1]} s.`);
    this.repeated = section && [section[0], section[1]];
  }

  get rate(): number {
    return this.speed;
  }

  set rate(rate: number) {
    this.speed = Math.min(Math.max(rate, 0), 16);
  }

  /** Start of the reel, in seconds. A live reel may have dropped what was before. */
  get earliest(): number {
    const { manifest } = this;
    return manifest && manifest.groups.length > 0 ? firstFrameOf(manifest, manifest.first)! / manifest.fps : 0;
  }

  /** End of the reel, in seconds; of a live reel, the end so far. */
  get duration(): number {
    return this.manifest ? this.manifest.frames / this.manifest.fps : 0;
  }

  get live(): boolean {
    return this.manifest?.live === true;
  }

  /** Start of the last group, in seconds, where playback of a live reel begins. */
  get edge(): number {
    return this.manifest ? this.manifest.groups.at(-1)!.firstFrame / this.manifest.fps : 0;
  }

  get ended(): boolean {
    return this.duration > 0 && !this.live && this.now >= this.duration;
  }

  /** Current frame of the video, which may lie between two. The last frame lasts until the end. */
  get frame(): number {
    const { fps, frames } = this.manifest!;
    return Math.min(this.now * fps, Math.max(frames - 1, 0));
  }

  /** Groups and frames shown now; null until the page that lists them arrives. */
  get moment(): Moment | null {
    const { manifest } = this;
    return momentAt(manifest!, manifest!.fps, this.frame / manifest!.fps);
  }

  /** Keep the time of a reel. The time does not change. */
  open(reel: Reel): void {
    this.current = reel;
  }

  /** Forget the reel, but keep the time, to reopen the reel later. */
  forget(): void {
    this.current = null;
  }

  /** Forget the reel, stop, and go to time 0. */
  reset(): void {
    [this.current, this.running, this.now, this.repeated] = [null, false, 0, null];
  }

  start(): void {
    this.running = true;
  }

  stop(): void {
    this.running = false;
  }

  /** Go to a time, clamped to the reel. */
  seek(seconds: number): void {
    this.now = Math.min(Math.max(seconds, this.earliest), this.duration);
  }

  /** Return the time of the frame that is `frames` after the nearest whole one. */
  timeAfter(frames: number): number {
    const { fps, frames: total } = this.manifest!;
    return Math.max(Math.min(Math.round(this.frame) + frames, total - 1) / fps, this.earliest);
  }

  /** Advance the time. Returns false if it waits at the end of a live reel. */
  advance(seconds: number): boolean {
    const { earliest, duration, live, loops } = this;
    if (live && !loops && this.now >= duration) return false;
    const before = this.now;
    this.now += seconds * this.speed;
    if (this.repeated) {
      const [start, end] = this.repeated.map((time) => Math.min(Math.max(time, earliest), duration));
      if (before < end && this.now >= end && end > start) this.now = start + ((this.now - end) % (end - start));
    }
    if (this.now >= duration) {
      // The last group of a live reel repeats until the next one arrives.
      if (loops) this.now = live ? this.edge : earliest + ((this.now - earliest) % (duration - earliest));
      else this.now = duration;
    }
    return true;
  }
}
