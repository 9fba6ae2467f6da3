/** Measures the bandwidth: bytes received, over the time in which requests were open. */

/** A sample ends after this many bits or seconds. The last few samples are averaged. */
const BITS = 2 ** 18;
const SECONDS = 0.25;
const SAMPLES = 5;
/** Age in seconds at which a sample is discarded. */
const AGE = 10;
/** Seconds without requests after which the optimistic rate doubles. */
const DOUBT = 5;

/** Average over the last samples. */
export class BandwidthMeter {
  private samples: { bits: number; seconds: number; now: number }[] = [];
  private bits = 0;
  private seconds = 0;
  private active = 0;
  private last = 0;

  /** Bits per second; 0 before the first sample. */
  get rate(): number {
    const sum = (key: "bits" | "seconds"): number => this.samples.reduce((total, sample) => total + sample[key], 0);
    const seconds = sum("seconds");
    return seconds > 0 ? sum("bits") / seconds : 0;
  }

  /** Return the rate, increased for the time without requests. now: milliseconds. */
  optimisticRate(now: number): number {
    return this.rate * (this.active > 0 ? 1 : 2 ** ((now - this.last) / 1000 / DOUBT));
  }

  /** Count a request as open. now: milliseconds. */
  begin(now: number): void {
    this.addTime(now);
    this.active++;
  }

  /** Count a request as closed. */
  end(now: number): void {
    this.addTime(now);
    this.active--;
  }

  /** Add received bytes. */
  addBytes(bytes: number, now: number): void {
    this.addTime(now);
    this.bits += 8 * bytes;
    if (this.seconds <= 0 || (this.bits < BITS && this.seconds < SECONDS)) return;
    this.samples.push({ bits: this.bits, seconds: this.seconds, now });
    this.samples = this.samples.slice(-SAMPLES).filter((sample) => now - sample.now < 1000 * AGE);
    [this.bits, this.seconds] = [0, 0];
  }

  private addTime(now: number): void {
    if (this.active > 0) this.seconds += (now - this.last) / 1000;
    this.last = now;
  }
}
