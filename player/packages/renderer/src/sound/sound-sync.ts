/** Synchronizes video to sound. The browser's clock of the sound is coarse, so the difference is smoothed. */

/** Time constant in seconds for correcting a difference. */
const SMOOTHING = 0.2;
/** Difference in seconds above which the video jumps. */
const JUMP = 0.04;
/** Seconds without a new reading after which the sound has stopped, and the video waits. */
const STOPPED = 0.25;
/** Seconds without a new reading after which the video continues without sound. */
const PATIENCE = 1.5;

/** Computes the steps of the video clock. */
export class SoundSync {
  /** True if the sound moves again after the video continued without it. */
  recovered = false;

  private reading: number | null = null;
  /** Time of the last new reading. */
  private readAt = 0;
  /** True once the reading has changed since the start. */
  private moving = false;
  /** True once the video has reached the sound. */
  private synced = false;
  /** True while the video continues without sound. */
  private lost = false;

  /** Restart after the sound starts or seeks. The video waits until the sound moves. */
  restart(): void {
    [this.reading, this.moving, this.synced, this.recovered] = [null, false, false, false];
  }

  /**
   * Return the step of the video in seconds of the reel, at least 0. sound, pictures: present times of sound and video, in seconds of the
   * reel. now: wall time in seconds; passed: wall time since the last call.
   */
  follow(sound: number, pictures: number, rate: number, now: number, passed: number): number {
    this.read(sound, now);
    const age = now - this.readAt;
    if (this.lost) return passed * rate;
    if (!this.moving || age > STOPPED) return 0;
    const ahead = sound + age * rate - pictures;
    // At the start the video waits for the sound to reach it, or jumps to the sound.
    const step = this.synced ? passed * rate : ahead;
    this.synced ||= ahead >= 0;
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
