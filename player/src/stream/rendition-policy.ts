/** Which rendition of the next group to get: by what network, decoder and screen kept up with, and by what is in store. */

/** A group in one rendition. */
export interface Option {
  bytes: number;
  points: number;
}

export interface Situation {
  /** Best first. */
  options: Option[];
  /** How long the group shows. */
  seconds: number;
  /** What is in store before it, seconds; less than nothing when it is late. */
  ahead: number;
  /** Bits a second that the network gave; 0: unknown. */
  throughput: number;
  /** Milliseconds that a point took to decode; 0: unknown. */
  decode: number;
  /** The option taken last; null: this is the first. */
  last: number | null;
}

/** Bits a second before anything is known, where the browser does not say. */
const GUESS = 5e6;
/** What its transfer may take of the time that a group shows: little while little is in store. */
const SHARES: [number, number][] = [[1, 0.5], [3, 0.8], [Infinity, 0.95]];
/** Of that, before something better than the last is taken: who goes up too soon comes down again. */
const UPWARDS = 0.7;
/** What decoding may take of it. */
const DECODING = 0.5;
/** Fewer points than this part of another option's are a help to a device that draws too slowly. */
const FEWER = 0.9;
/** Milliseconds until fewer points show an effect, and until more are tried again; twice as many after each time. */
const EFFECT = 6000;
const PATIENCE = 20_000;

export class RenditionPolicy {
  /** The best option that the device draws fast enough. */
  private best = 0;
  private patience = PATIENCE;
  private decided = -Infinity;

  /** guess: bits a second, while nothing is known. */
  constructor(private readonly guess = GUESS) {}

  /** The index of an option. */
  choose({ options, seconds, ahead, throughput, decode, last }: Situation): number {
    const share = SHARES.find(([least]) => ahead < least)![1];
    const fits = ({ bytes, points }: Option, index: number): boolean => {
      const caution = last !== null && index < last ? UPWARDS : 1;
      const transfer = (8 * bytes) / (throughput || this.guess);
      return index >= this.best && transfer <= caution * share * seconds && (decode * points) / 1000 <= caution * DECODING * seconds;
    };
    const found = options.findIndex(fits);
    return found < 0 ? options.length - 1 : found;
  }

  /** Tell how drawing goes with the option that shows; now: milliseconds. */
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

/** Bits a second that the browser believes in, at most ten million; a cautious number where it does not say. */
export function guessOfBrowser(): number {
  const { connection } = navigator as { connection?: { downlink?: number } };
  return connection?.downlink ? Math.max(connection.downlink * 1e6, 1e5) : GUESS;
}
