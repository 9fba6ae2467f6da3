/** Pixels of the picture per CSS pixel: as many as the device keeps up with, and all of them once nothing moves. */

export type Quality = "auto" | "full" | "half";

/** Above this mean interval of pictures, milliseconds, the picture gets coarser; below the other one finer. */
const SLOW = 27;
const FAST = 17.5;
/** What is aimed at when it gets coarser. */
const AIM = 22;
/** Above this one there are too many points for the device. */
const STRUGGLING = 45;
/** Pictures to judge by; fewer where they take so many milliseconds together. */
const WINDOW = 12;
const FEWEST = 3;
const LONG = 300;
const COARSEST = 0.5;
/** Pauses longer than this, milliseconds, say nothing about the device. */
const PAUSE = 2000;
/** Milliseconds without a new picture after which the last one is drawn in full. */
const REST = 250;

export class Resolution {
  /** Mean milliseconds between pictures that follow each other. */
  interval = 1000 / 60;

  private chosen: Quality = "auto";
  private scale = 1;
  private last = 0;
  private lastDrawn = 0;
  private still = false;
  private count = 0;
  private spent = 0;
  /** Windows to wait before trying a finer picture again: twice as many after each that was too fine. */
  private patience = 2;
  private waited = 0;

  /** What people chose: automatic, or a fixed share of the pixels. */
  get quality(): Quality {
    return this.chosen;
  }

  set quality(quality: Quality) {
    this.chosen = quality;
  }

  /** Pixels per CSS pixel. */
  get ratio(): number {
    const device = Math.min(globalThis.devicePixelRatio || 1, 2);
    return device * { auto: this.still ? 1 : this.scale, full: 1, half: 0.5 }[this.chosen];
  }

  /** The device does not keep up, however coarse the picture may get. */
  get struggling(): boolean {
    return this.interval > STRUGGLING && (this.chosen !== "auto" || this.scale <= COARSEST);
  }

  /** Begin with few pixels: the device is known to be slow. */
  startCoarse(): void {
    this.scale = COARSEST;
  }

  /** Nothing moves from now on: the next picture is one in full. */
  settle(): void {
    this.still = true;
  }

  /** Something changes: pictures follow each other again. */
  move(): void {
    this.still = false;
  }

  /** Whether the picture should be drawn once more, in full, since nothing moves. */
  becomesStill(now: number): boolean {
    if (this.still || this.chosen !== "auto" || this.scale === 1 || now - this.lastDrawn < REST) return false;
    this.still = true;
    return true;
  }

  /** Tell of every tick whether it drew, and when; true where there are enough pictures to judge by. */
  drawn(drawn: boolean, now: number): boolean {
    const interval = now - this.last;
    this.last = drawn && !this.still ? now : 0;
    if (drawn) this.lastDrawn = now;
    if (!drawn || this.still || interval > PAUSE) return false;
    this.interval += (interval - this.interval) * 0.1;
    this.spent += interval;
    if (++this.count < WINDOW && (this.count < FEWEST || this.spent < LONG)) return false;
    this.judge(this.spent / this.count);
    [this.count, this.spent] = [0, 0];
    return true;
  }

  private judge(interval: number): void {
    if (interval > SLOW && this.scale > COARSEST) {
      if (this.waited === 0) this.patience *= 2;
      this.scale = Math.max(this.scale * Math.min(Math.sqrt(AIM / interval), 0.8), COARSEST);
      this.waited = 0;
    } else if (interval < FAST && this.scale < 1 && ++this.waited > this.patience) {
      this.scale = Math.min(1.25 * this.scale, 1);
      this.waited = 0;
    }
  }
}
