/** How fast the network is: what came, over the time in which something was asked for. */

/** A sample is whole after so many bits or seconds; the last few count. */
const BITS = 2 ** 18;
const SECONDS = 0.25;
const SAMPLES = 5;
/** Older samples, in seconds, go when a new one comes. */
const AGE = 10;
/** A line that nothing was asked of may be twice as fast after this many seconds, four times after twice as many. */
const DOUBT = 5;

export class BandwidthMeter {
  private samples: { bits: number; seconds: number; now: number }[] = [];
  private bits = 0;
  private seconds = 0;
  private active = 0;
  private last = 0;

  /** Bits a second; 0 while nothing is known. */
  get rate(): number {
    const sum = (key: "bits" | "seconds"): number => this.samples.reduce((total, sample) => total + sample[key], 0);
    const seconds = sum("seconds");
    return seconds > 0 ? sum("bits") / seconds : 0;
  }

  /** What the rate may be by now: it grows while nothing is asked for. */
  optimisticRate(now: number): number {
    return this.rate * (this.active > 0 ? 1 : 2 ** ((now - this.last) / 1000 / DOUBT));
  }

  /** A transfer was asked for; now: milliseconds. */
  begin(now: number): void {
    this.pass(now);
    this.active++;
  }

  /** It ended, however. */
  end(now: number): void {
    this.pass(now);
    this.active--;
  }

  /** Bytes came. */
  came(bytes: number, now: number): void {
    this.pass(now);
    this.bits += 8 * bytes;
    if (this.seconds <= 0 || (this.bits < BITS && this.seconds < SECONDS)) return;
    this.samples.push({ bits: this.bits, seconds: this.seconds, now });
    this.samples = this.samples.slice(-SAMPLES).filter((sample) => now - sample.now < 1000 * AGE);
    [this.bits, this.seconds] = [0, 0];
  }

  private pass(now: number): void {
    if (this.active > 0) this.seconds += (now - this.last) / 1000;
    this.last = now;
  }
}
