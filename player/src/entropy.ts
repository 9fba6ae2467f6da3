/** Whole numbers out of an rANS stream of many lanes (docs/format.md). */
import { inflate } from "./dequantize";
import { ReelError } from "./errors";

const HEADER_BYTES = 12;
const SCALE_BITS = 12;
const SCALE = 1 << SCALE_BITS;
const LOW = 65536;
/** Numbers below it are their own token. */
const DIRECT = 32;
const TOKENS = 128;

export class EntropyDecoder {
  private word = 0;
  private bit = 0;
  private lane = 0;

  private constructor(
    /** [contexts * 4096] token << 25 | frequency << 12 | place in the token's interval. */
    private readonly lookup: Uint32Array,
    private readonly states: Uint32Array,
    private readonly words: Uint16Array,
    private readonly raw: Uint8Array,
  ) {}

  static async open(data: Uint8Array, contexts: number): Promise<EntropyDecoder> {
    if (data.byteLength < HEADER_BYTES) throw new ReelError("a stream is too short");
    const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    const lanes = 1 << data[0];
    const tableBytes = view.getUint16(2, true);
    const words = view.getUint32(4, true);
    const rawBytes = view.getUint32(8, true);
    const statesAt = HEADER_BYTES + tableBytes;
    const wordsAt = statesAt + 4 * lanes;
    const rawAt = wordsAt + 2 * words;
    if (data[0] > 10 || data[1] !== contexts || rawAt + rawBytes !== data.byteLength) throw new ReelError("a stream does not fit its header");
    const tables = await inflate(data.subarray(HEADER_BYTES, statesAt), true, contexts * (1 + 2 * TOKENS), false);
    return new EntropyDecoder(
      lookupOf(tables, contexts),
      Uint32Array.from({ length: lanes }, (_, i) => view.getUint32(statesAt + 4 * i, true)),
      Uint16Array.from({ length: words }, (_, i) => view.getUint16(wordsAt + 2 * i, true)),
      data.subarray(rawAt),
    );
  }

  /** Every batch begins at the first lane. */
  begin(): void {
    this.lane = 0;
  }

  /** The next number of the batch, 0 to 2^52 - 1. */
  next(context: number): number {
    const { states, lane } = this;
    let state = states[lane];
    const entry = this.lookup[(context << SCALE_BITS) | (state & (SCALE - 1))];
    state = ((entry >>> 12) & 0x1fff) * (state >>> SCALE_BITS) + (entry & 0xfff);
    if (state < LOW) {
      if (this.word === this.words.length) throw new ReelError("a stream ends too early");
      state = state * LOW + this.words[this.word++];
    }
    states[lane] = state;
    this.lane = lane + 1 === states.length ? 0 : lane + 1;
    const token = entry >>> 25;
    return token < DIRECT ? token : this.long(token - DIRECT);
  }

  /** Throws unless everything was read and came out as it went in. */
  finish(): void {
    const whole = this.word === this.words.length && (this.bit + 7) >>> 3 === this.raw.length;
    if (!whole || this.states.some((state) => state !== LOW)) throw new ReelError("a stream is damaged");
  }

  private long(token: number): number {
    const bits = (token >> 1) + 4;
    if (this.bit + bits > 8 * this.raw.length) throw new ReelError("a stream ends too early");
    let value = 0;
    let scale = 1;
    for (let left = bits; left > 0; ) {
      const offset = this.bit & 7;
      const take = Math.min(8 - offset, left);
      value += ((this.raw[Math.floor(this.bit / 8)] >> offset) & ((1 << take) - 1)) * scale;
      scale *= 1 << take;
      this.bit += take;
      left -= take;
    }
    return (2 | (token & 1)) * scale + value;
  }
}

/** 0, 1, 2, 3 become 0, -1, 1, -2. */
export function unzigzag(value: number): number {
  if (value < 2 ** 31) return (value >>> 1) ^ -(value & 1);
  return value % 2 === 0 ? value / 2 : -(value + 1) / 2;
}

function lookupOf(tables: Uint8Array, contexts: number): Uint32Array {
  const result = new Uint32Array(contexts * SCALE);
  let at = 0;
  for (let context = 0; context < contexts; context++) {
    const used = at < tables.length ? tables[at] : TOKENS + 1;
    if (used > TOKENS || at + 1 + 2 * used > tables.length) throw new ReelError("frequencies are cut off");
    let place = 0;
    for (let token = 0; token < used; token++) {
      const frequency = tables[at + 1 + 2 * token] | (tables[at + 2 + 2 * token] << 8);
      if (place + frequency > SCALE) throw new ReelError("frequencies do not sum to 4096");
      const base = ((token << 25) | (frequency << 12)) >>> 0;
      for (let i = 0; i < frequency; i++) result[context * SCALE + place + i] = base + i;
      place += frequency;
    }
    if (place !== 0 && place !== SCALE) throw new ReelError("frequencies do not sum to 4096");
    at += 1 + 2 * used;
  }
  if (at !== tables.length) throw new ReelError("there are more frequencies than contexts");
  return result;
}
