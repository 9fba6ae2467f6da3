/** How fast the network is: what came, over the time in which something was asked for. */

/** A sample is whole after so many bits or seconds; the last few count. */
const BITS = 2 ** 18;
const SECONDS = 0.25;
const SAMPLES = 5;

export class Meter {
  private readonly samples: { bits: number; seconds: number }[] = [];
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
    this.samples.push({ bits: this.bits, seconds: this.seconds });
    if (this.samples.length > SAMPLES) this.samples.shift();
    [this.bits, this.seconds] = [0, 0];
  }

  private pass(now: number): void {
    if (this.active > 0) this.seconds += (now - this.last) / 1000;
    this.last = now;
  }
}
