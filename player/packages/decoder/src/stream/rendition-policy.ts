/** Adaptive choice of renditions, by network, decoder, drawing speed and buffer. */

/** A group in one rendition. */
export interface Option {
  bytes: number;
  points: number;
}

/** Inputs of a choice. */
export interface Situation {
  /** Best first. */
  options: Option[];
  /** Duration of the group. */
  seconds: number;
  /** Buffered seconds before the group; negative if it is late. */
  ahead: number;
  /** Throughput in bits per second; 0 if unknown. */
  throughput: number;
  /** Decoding time in milliseconds per point; 0 if unknown. */
  decode: number;
  /** Index of the last chosen option; null for the first choice. */
  last: number | null;
}

/** Assumed bits per second before any measurement, if the browser reports none. */
const GUESS = 5e6;
/** Part of a group's duration that its transfer may take, by buffered seconds. */
const SHARES: [number, number][] = [
  [1, 0.5],
  [3, 0.8],
  [Infinity, 0.95],
];
/** Stricter factor for an option better than the last one, to avoid switching up and down. */
const UPGRADE = 0.7;
/** Part of a group's duration that its decoding may take. */
const DECODING = 0.5;
/** An option helps a slow device if it has less than this part of the points. */
const FEWER = 0.9;
/** Milliseconds until a reduction shows an effect, and until a better option is tried again. The latter doubles each time. */
const EFFECT = 6000;
const PATIENCE = 20_000;

/** Chooses an option, and learns how many points the device draws. */
export class RenditionPolicy {
  /** Index of the best option that the device draws fast enough. */
  private best = 0;
  private patience = PATIENCE;
  private decided = -Infinity;

  /** guess: bits per second before any measurement. */
  constructor(private readonly guess = GUESS) {}

  /** Return the index of the option to request. */
  choose({ options, seconds, ahead, throughput, decode, last }: Situation): number {
    const share = SHARES.find(([least]) => ahead < least)![1];
    const fits = ({ bytes, points }: Option, index: number): boolean => {
      const caution = last !== null && index < last ? UPGRADE : 1;
      const transfer = (8 * bytes) / (throughput || this.guess);
      return (
        index >= this.best &&
        transfer <= caution * share * seconds &&
        (decode * points) / 1000 <= caution * DECODING * seconds
      );
    };
    const found = options.findIndex(fits);
    return found < 0 ? options.length - 1 : found;
  }

  /** Report whether the device draws the shown option too slowly. now: milliseconds. */
  judge(slow: boolean, options: Option[], shown: number, now: number): void {
    if (slow && now > this.decided + EFFECT) {
      const fewer = options.findIndex(({ points }, index) => index > shown && points < FEWER * options[shown].points);
      if (fewer < 0) return;
      if (this.best > 0) this.patience *= 2;
      [this.best, this.decided] = [fewer, now];
    } else if (!slow && this.best > 0 && now > this.decided + this.patience) {
      [this.best, this.decided] = [this.best - 1, now];
    }
  }
}

/** Return the bandwidth that the browser reports, in bits per second, or a cautious guess. */
export function guessOfBrowser(): number {
  const { connection } = (globalThis.navigator ?? {}) as { connection?: { downlink?: number } };
  return connection?.downlink ? Math.max(connection.downlink * 1e6, 1e5) : GUESS;
}
