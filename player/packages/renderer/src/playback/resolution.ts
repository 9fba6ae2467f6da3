/** Adaptive resolution: as many pixels as the device keeps up with, and full resolution while nothing moves. */

/** Setting of the menu. */
export type Quality = "auto" | "full" | "half";

/** Mean frame interval in milliseconds above which the resolution decreases, and below which it increases. */
const SLOW = 27;
const FAST = 17.5;
/** Frame interval that a decrease aims at. */
const TARGET = 22;
/** Frame interval above which the device has too many points to draw. */
const STRUGGLING = 45;
/** Number of frames per decision; fewer if together they take LONG milliseconds. */
const WINDOW = 12;
const FEWEST = 3;
const LONG = 300;
const COARSEST = 0.5;
/** Milliseconds above which an interval is a pause and does not count. */
const PAUSE = 2000;
/** Milliseconds without a new frame after which the last one is redrawn in full resolution. */
const REST = 250;

/** Chooses the pixel ratio by the frame interval. */
export class Resolution {
  /** Mean frame interval in milliseconds. */
  interval = 1000 / 60;

  private chosen: Quality = "auto";
  private scale = 1;
  private last = 0;
  private lastDrawn = 0;
  private still = false;
  private count = 0;
  private spent = 0;
  /** Decisions to wait before an increase. It doubles after each increase that was too much. */
  private patience = 2;
  private waited = 0;

  /** The chosen setting. */
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

  /** True if the device does not keep up even at the lowest resolution. */
  get struggling(): boolean {
    return this.interval > STRUGGLING && (this.chosen !== "auto" || this.scale <= COARSEST);
  }

  /** Begin at the lowest resolution, for a slow device. */
  startCoarse(): void {
    this.scale = COARSEST;
  }

  /** Use full resolution from now on, since nothing moves. */
  settle(): void {
    this.still = true;
  }

  /** Use the adaptive resolution again, since something moves. */
  move(): void {
    this.still = false;
  }

  /** Return true once nothing has moved for a while, so that the frame should be redrawn in full resolution. */
  becomesStill(now: number): boolean {
    if (this.still || this.chosen !== "auto" || this.scale === 1 || now - this.lastDrawn < REST) return false;
    this.still = true;
    return true;
  }

  /** Report a tick and whether it drew. Returns true if a decision was made. */
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
      this.scale = Math.max(this.scale * Math.min(Math.sqrt(TARGET / interval), 0.8), COARSEST);
      this.waited = 0;
    } else if (interval < FAST && this.scale < 1 && ++this.waited > this.patience) {
      this.scale = Math.min(1.25 * this.scale, 1);
      this.waited = 0;
    }
  }
}
