/** Decoding of integers from an rANS stream (docs/format.md). */
import { ReelError } from "../base/errors";

const HEADER_BYTES = 12;
const SCALE_BITS = 12;
const SCALE = 1 << SCALE_BITS;
const LOW = 65536;
/** Smaller numbers are their own token. */
const DIRECT = 32;
const TOKENS = 128;
/** Maximum number of raw bits of a number below 2^31. */
const LONGEST = 29;

/** The parts of a stream. */
export interface Stream {
  /** [contexts * 4096] token << 25 | frequency << 12 | position in the token's interval. */
  lookup: Uint32Array;
  states: Uint32Array;
  words: Uint16Array;
  /** Raw bits, padded with eight zero bytes, so that whole words can be read. */
  raw: Uint8Array;
  rawBytes: number;
}

/** Split a stream into its parts. */
export function streamOf(data: Uint8Array, contexts: number): Stream {
  if (data.byteLength < HEADER_BYTES) throw new ReelError("a stream is too short");
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const lanes = 1 << data[0];
  const tableBytes = view.getUint16(2, true);
  const words = view.getUint32(4, true);
  const rawBytes = view.getUint32(8, true);
  const statesAt = HEADER_BYTES + tableBytes;
  const wordsAt = statesAt + 4 * lanes;
  const rawAt = wordsAt + 2 * words;
  if (data[0] > 10 || data[1] !== contexts || rawAt + rawBytes !== data.byteLength)
    throw new ReelError("a stream does not fit its header");
  // Copies are aligned to their element size.
  return {
    lookup: lookupOf(data.subarray(HEADER_BYTES, statesAt), contexts),
    states: new Uint32Array(data.slice(statesAt, wordsAt).buffer),
    words: new Uint16Array(data.slice(wordsAt, rawAt).buffer),
    raw: padded(data.subarray(rawAt)),
    rawBytes,
  };
}

/** Decodes integers from interleaved rANS states. */
export class EntropyDecoder {
  private word = 0;
  private bit = 0;
  private lane = 0;
  private readonly lookup: Uint32Array;
  private readonly states: Uint32Array;
  private readonly words: Uint16Array;
  private readonly raw: Uint8Array;
  private readonly rawBytes: number;

  constructor(data: Uint8Array, contexts: number) {
    ({
      lookup: this.lookup,
      states: this.states,
      words: this.words,
      raw: this.raw,
      rawBytes: this.rawBytes,
    } = streamOf(data, contexts));
  }

  /** Return the next number, below 2^31. Throws for larger ones. */
  next(context: number): number {
    const token = this.token(context);
    return token < DIRECT ? token : this.long(token - DIRECT);
  }

  /** Return the next number, below 2^52. */
  nextLarge(context: number): number {
    const token = this.token(context) - DIRECT;
    if (token < 0) return token + DIRECT;
    const bits = (token >> 1) + 4;
    if (bits <= LONGEST) return this.long(token);
    const low = this.bits(LONGEST);
    return (2 | (token & 1)) * 2 ** bits + this.bits(bits - LONGEST) * 2 ** LONGEST + low;
  }

  /** Throw unless all data was read and the final states are intact. */
  finish(): void {
    const whole = this.word === this.words.length && (this.bit + 7) >>> 3 === this.rawBytes;
    if (!whole || this.states.some((state) => state !== LOW)) throw new ReelError("a stream is damaged");
  }

  private token(context: number): number {
    const { states, lane } = this;
    let state = states[lane];
    const entry = this.lookup[(context << SCALE_BITS) | (state & (SCALE - 1))];
    state = ((entry >>> 12) & 0x1fff) * (state >>> SCALE_BITS) + (entry & 0xfff);
    if (state < LOW) {
      if (this.word === this.words.length) throw new ReelError("a stream ends too early");
      state = (state << 16) | this.words[this.word++];
    }
    states[lane] = state;
    this.lane = (lane + 1) & (states.length - 1);
    return entry >>> 25;
  }

  private long(token: number): number {
    const bits = (token >> 1) + 4;
    if (bits > LONGEST) throw new ReelError("a stream holds numbers that are too large");
    return ((2 | (token & 1)) << bits) | this.bits(bits);
  }

  /** Return the next `count` raw bits, at most LONGEST. */
  private bits(count: number): number {
    const { raw, bit } = this;
    const at = bit >>> 3;
    if (at > this.rawBytes) throw new ReelError("a stream ends too early");
    const offset = bit & 7;
    this.bit = bit + count;
    const low = (raw[at] | (raw[at + 1] << 8) | (raw[at + 2] << 16) | (raw[at + 3] << 24)) >>> offset;
    const window = offset === 0 ? low : low | (raw[at + 4] << (32 - offset));
    return window & ((1 << count) - 1);
  }
}

function padded(bytes: Uint8Array): Uint8Array {
  const result = new Uint8Array(bytes.length + 8);
  result.set(bytes);
  return result;
}

/** Map 0, 1, 2, 3 to 0, -1, 1, -2. */
export function unzigzag(value: number): number {
  return (value >>> 1) ^ -(value & 1);
}

/** Reads bits, lowest of a byte first. */
class Bits {
  private at = 0;

  constructor(private readonly bytes: Uint8Array) {}

  take(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++, this.at++) {
      if (this.at >= 8 * this.bytes.length) throw new ReelError("frequencies are cut off");
      value |= ((this.bytes[this.at >>> 3] >>> (this.at & 7)) & 1) << i;
    }
    return value;
  }

  /** Return an Elias gamma code: b zeros, a one, and the low b bits of a number of b + 1 bits. */
  gamma(): number {
    let low = 0;
    while (this.take(1) === 0) if (++low > 8) throw new ReelError("frequencies are damaged");
    return (1 << low) | this.take(low);
  }

  get whole(): boolean {
    return (this.at + 7) >>> 3 === this.bytes.length;
  }
}

function lookupOf(tables: Uint8Array, contexts: number): Uint32Array {
  const result = new Uint32Array(contexts * SCALE);
  const bits = new Bits(tables);
  for (let context = 0; context < contexts; context++) {
    const used = bits.gamma() - 1;
    if (used > TOKENS) throw new ReelError("there are too many frequencies");
    let place = context * SCALE;
    const end = place + SCALE;
    for (let token = 0, length = 0; token < used; token++) {
      length += unzigzag(bits.gamma() - 1);
      if (length < 0 || length > SCALE_BITS + 1) throw new ReelError("frequencies are damaged");
      const frequency = length === 0 ? 0 : (1 << (length - 1)) | bits.take(length - 1);
      if (place + frequency > end) throw new ReelError("frequencies do not sum to 4096");
      const base = ((token << 25) | (frequency << SCALE_BITS)) >>> 0;
      for (let i = 0; i < frequency; i++) result[place++] = base + i;
    }
    if (place !== end && place !== end - SCALE) throw new ReelError("frequencies do not sum to 4096");
  }
  if (!bits.whole) throw new ReelError("there are more frequencies than contexts");
  return result;
}
