/** Lets the time of the pictures follow the sound: what a browser tells of the sound's time is coarse, and pictures must not jump. */

/** Seconds in which a difference is made up for. */
const SMOOTHING = 0.2;
/** A difference of more seconds is not made up for but skipped. */
const JUMP = 0.04;
/** Sound that tells no new time for so many seconds has stopped: pictures wait. */
const STOPPED = 0.25;
/** After so many seconds without a new time the pictures go on without it. */
const PATIENCE = 1.5;

export class SoundSync {
  /** The sound stood still for long and moves again: pictures have gone on without it. */
  recovered = false;

  private reading: number | null = null;
  /** When the reading was new. */
  private readAt = 0;
  /** The reading has changed since the start: sound is heard. */
  private moving = false;
  /** Pictures and sound are at the same time. */
  private together = false;
  /** Pictures go on without it. */
  private lost = false;

  /** The sound starts, or starts elsewhere: pictures wait until it is heard. */
  restart(): void {
    [this.reading, this.moving, this.together, this.recovered] = [null, false, false, false];
  }

  /**
   * Seconds of the reel that the pictures go on by, never back. sound: what is heard now; pictures: what is seen now, both seconds
   * of the reel; now, passed: seconds on the wall, the latter since the last call.
   */
  follow(sound: number, pictures: number, rate: number, now: number, passed: number): number {
    this.read(sound, now);
    const age = now - this.readAt;
    if (this.lost) return passed * rate;
    if (!this.moving || age > STOPPED) return 0;
    const ahead = sound + age * rate - pictures;
    // Pictures that stand still wait for the sound to reach them, or go where it is.
    const step = this.together ? passed * rate : ahead;
    this.together ||= ahead >= 0;
    const difference = ahead - step;
    if (Math.abs(difference) > JUMP) return Math.max(ahead, 0);
    return Math.max(step + difference * (1 - Math.exp(-passed / SMOOTHING)), 0);
  }

  private read(sound: number, now: number): void {
    if (sound !== this.reading) {
      this.moving = this.reading !== null;
      [this.reading, this.readAt] = [sound, now];
      if (this.moving) [this.lost, this.recovered] = [false, this.recovered || this.lost];
    } else if (now - this.readAt > PATIENCE) this.lost = true;
  }
}
