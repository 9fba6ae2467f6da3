/** Pixels of the picture per CSS pixel: as many as the device keeps up with. */

export type Quality = "auto" | "full" | "half";

/** Above this mean interval of pictures, milliseconds, the picture gets coarser; below the other one finer. */
const SLOW = 27;
const FAST = 17.5;
/** Above this one there are too many points for the device. */
const STRUGGLING = 45;
/** Pictures to judge by. */
const WINDOW = 12;
const COARSEST = 0.5;
/** Pauses longer than this, milliseconds, say nothing about the device. */
const PAUSE = 2000;

export class Resolution {
  quality: Quality = "auto";
  /** Mean milliseconds between pictures that follow each other. */
  interval = 1000 / 60;

  private scale = 1;
  private last = 0;
  private count = 0;
  /** Windows to wait before trying a finer picture again: twice as many after each that was too fine. */
  private patience = 2;
  private waited = 0;

  get ratio(): number {
    const device = Math.min(globalThis.devicePixelRatio || 1, 2);
    return device * { auto: this.scale, full: 1, half: 0.5 }[this.quality];
  }

  /** The device does not keep up, however coarse the picture may get. */
  get struggling(): boolean {
    return this.interval > STRUGGLING && (this.quality !== "auto" || this.scale <= COARSEST);
  }

  /** Tell of every tick whether it drew, and when; true where there are enough pictures to judge by. */
  drawn(drawn: boolean, now: number): boolean {
    const interval = now - this.last;
    this.last = drawn ? now : 0;
    if (!drawn || interval > PAUSE) return false;
    this.interval += (interval - this.interval) * 0.1;
    if (++this.count % WINDOW > 0) return false;
    this.judge();
    return true;
  }

  private judge(): void {
    if (this.interval > SLOW && this.scale > COARSEST) {
      if (this.waited === 0) this.patience *= 2;
      this.scale = Math.max(0.8 * this.scale, COARSEST);
      this.waited = 0;
    } else if (this.interval < FAST && this.scale < 1 && ++this.waited > this.patience) {
      this.scale = Math.min(1.25 * this.scale, 1);
      this.waited = 0;
    }
  }
}
