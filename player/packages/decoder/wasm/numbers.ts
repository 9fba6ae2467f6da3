/**
 * The hot loops of the predictive codec for WebAssembly, in AssemblyScript: the same arithmetic as ../src/decode/entropy.ts, lod-prediction.ts and klt.ts, and the
 * same numbers bit by bit. Arrays are addresses in this module's memory, which ../src/decode/wasm.ts lays out. What a file claims never decides where is
 * read or written: words and bits are counted against their ends, contexts and neighbours are made here or by the caller.
 */

/** Return values of `lod`. */
const FINE: u32 = 0;
const ENDS_EARLY: u32 = 1;
const TOO_LARGE: u32 = 2;
const SUM_TOO_LARGE: u32 = 3;
const DAMAGED: u32 = 4;

const SCALE_BITS: u32 = 12;
const LOW: u32 = 65536;
const DIRECT: u32 = 32;
const LONGEST: u32 = 29;
const LIMIT: i64 = 1 << 30;
const LARGEST: i32 = 4095;
const LARGEST_SIZE: i64 = 65535;
const REACH: i32 = 8;
const WEIGHT: f64 = 4096;

/** Return the start of free memory. */
export function begin(): usize {
  return __heap_base;
}

// Stream that `lod` reads.
let lookup: usize = 0;
let states: usize = 0;
let lanes: u32 = 0;
let words: usize = 0;
let wordsEnd: usize = 0;
let raw: usize = 0;
let rawBytes: u32 = 0;

/** lookup: u32 [contexts, 4096] as in ../src/decode/entropy.ts; states: u32 [lanes]; words: u16 [wordCount]; raw: rawBytes and 8 zeros. */
export function open(lookupAt: usize, statesAt: usize, laneCount: u32, wordsAt: usize, wordCount: u32, rawAt: usize, bytes: u32): void {
  lookup = lookupAt;
  states = statesAt;
  lanes = laneCount;
  words = wordsAt;
  wordsEnd = wordsAt + 2 * wordCount;
  raw = rawAt;
  rawBytes = bytes;
}

/**
 * found: i32 [count, columns] of zeros, what is decoded; sizes: u16 [count, columns] of zeros, scratch; contextOf: u8 [4096]; order: u32 [count];
 * neighbours: u32 [count, 4]; weights: u16 [count, 4]; shifts: u8 [count]; ends: i32 [count], or 0 where all points have all columns.
 */
export function lod(found: usize, sizes: usize, contextOf: usize, order: usize, neighbours: usize, weights: usize, shifts: usize, ends: usize, count: u32, columns: u32): u32 {
  let word = words;
  let bit: u32 = 0;
  let lane: u32 = 0;
  const laneMask = lanes - 1;
  for (let place: u32 = 0; place < count; place++) {
    const point = load<u32>(order + 4 * place);
    const end = ends ? load<u32>(ends + 4 * point) : columns;
    if (end == 0) continue;
    const shift = <u32>load<u8>(shifts + point);
    const n = neighbours + 16 * place;
    const w = weights + 8 * place;
    const p = <i32>load<u16>(w);
    const q = <i32>load<u16>(w, 2);
    const r = <i32>load<u16>(w, 4);
    const s = <i32>load<u16>(w, 6);
    const a = columns * load<u32>(n);
    const b = columns * load<u32>(n, 4);
    const c = columns * load<u32>(n, 8);
    const d = columns * load<u32>(n, 12);
    const at = columns * point;
    let recent: i32 = -1;
    for (let column: u32 = 0; column < end; column++) {
      const to = found + 4 * (at + column);
      const sizeTo = sizes + 2 * (at + column);
      const sum =
        <i64>p * <i64>load<i32>(found + 4 * (a + column)) +
        <i64>q * <i64>load<i32>(found + 4 * (b + column)) +
        <i64>r * <i64>load<i32>(found + 4 * (c + column)) +
        <i64>s * <i64>load<i32>(found + 4 * (d + column));
      const size =
        p * <i32>load<u16>(sizes + 2 * (a + column)) +
        q * <i32>load<u16>(sizes + 2 * (b + column)) +
        r * <i32>load<u16>(sizes + 2 * (c + column)) +
        s * <i32>load<u16>(sizes + 2 * (d + column));
      const around = min<i32>(size >> (9 + shift), LARGEST);
      if (recent < 0) recent = around;
      const context = <u32>load<u8>(contextOf + <usize>((around + recent) >> 1));

      const stateAt = states + 4 * lane;
      lane = (lane + 1) & laneMask;
      let state = load<u32>(stateAt);
      const entry = load<u32>(lookup + 4 * ((context << SCALE_BITS) | (state & 4095)));
      state = ((entry >> 12) & 0x1fff) * (state >> SCALE_BITS) + (entry & 0xfff);
      if (state < LOW) {
        if (word == wordsEnd) return ENDS_EARLY;
        state = (state << 16) | <u32>load<u16>(word);
        word += 2;
      }
      store<u32>(stateAt, state);
      let number = entry >> 25;
      if (number >= DIRECT) {
        number -= DIRECT;
        const bits = (number >> 1) + 4;
        if (bits > LONGEST) return TOO_LARGE;
        const byte = bit >> 3;
        if (byte > rawBytes) return ENDS_EARLY;
        const window = load<u64>(raw + byte) >> <u64>(bit & 7);
        bit += bits;
        number = ((2 | (number & 1)) << bits) | (<u32>window & ((1 << bits) - 1));
      }

      const steps = (number + 1) >> 1;
      const moved = <i64>steps << <i64>shift;
      const result = ((sum + 2048) >> 12) + (number & 1 ? -moved : moved);
      if (result >= LIMIT || result <= -LIMIT) return SUM_TOO_LARGE;
      recent += (<i32>min<u32>(8 * min<u32>(steps, 512), LARGEST) - recent) >> 2;
      store<i32>(to, <i32>result);
      store<u16>(sizeTo, <u16>min<i64>(moved, LARGEST_SIZE));
    }
  }
  if (word != wordsEnd || (bit + 7) >> 3 != rawBytes) return DAMAGED;
  for (let i: u32 = 0; i < lanes; i++) if (load<u32>(states + 4 * i) != LOW) return DAMAGED;
  return FINE;
}

/** Write the neighbors u32 [4] and weights u16 [4] of a point: the nearest of 16 multiples of stride in positions i32 [count, 3], with weights that decrease with distance. */
function nearest(quantized: usize, count: i32, point: i32, stride: i32, neighbours: usize, weights: usize): void {
  const middle = point / stride;
  const here = quantized + 12 * point;
  const x = <f64>load<i32>(here);
  const y = <f64>load<i32>(here, 4);
  const z = <f64>load<i32>(here, 8);
  let s0 = Infinity, s1 = Infinity, s2 = Infinity, s3 = Infinity;
  let i0 = 0, i1 = 0, i2 = 0, i3 = 0;
  const first = max<i32>(middle + 1 - REACH, 0);
  const last = min<i32>(middle + REACH, (count - 1) / stride);
  for (let slot = first; slot <= last; slot++) {
    const candidate = slot * stride;
    const there = quantized + 12 * candidate;
    const dx = <f64>load<i32>(there) - x;
    const dy = <f64>load<i32>(there, 4) - y;
    const dz = <f64>load<i32>(there, 8) - z;
    const square = dx * dx + dy * dy + dz * dz;
    if (square >= s3) continue;
    if (square < s2) {
      s3 = s2; i3 = i2;
      if (square < s1) {
        s2 = s1; i2 = i1;
        if (square < s0) {
          s1 = s0; i1 = i0;
          s0 = square; i0 = candidate;
        } else { s1 = square; i1 = candidate; }
      } else { s2 = square; i2 = candidate; }
    } else { s3 = square; i3 = candidate; }
  }
  const n0 = s0 < Infinity ? 1 / (1 + sqrt(s0)) : 0;
  const n1 = s1 < Infinity ? 1 / (1 + sqrt(s1)) : 0;
  const n2 = s2 < Infinity ? 1 / (1 + sqrt(s2)) : 0;
  const n3 = s3 < Infinity ? 1 / (1 + sqrt(s3)) : 0;
  const total = n0 + n1 + n2 + n3;
  const w1 = <i32>floor((n1 * WEIGHT) / total);
  const w2 = <i32>floor((n2 * WEIGHT) / total);
  const w3 = <i32>floor((n3 * WEIGHT) / total);
  const w0 = 4096 - w1 - w2 - w3;
  store<u16>(weights, w0);
  store<u16>(weights, w1, 2);
  store<u16>(weights, w2, 4);
  store<u16>(weights, w3, 6);
  store<i32>(neighbours, w0 > 0 ? i0 : 0);
  store<i32>(neighbours, w1 > 0 ? i1 : 0, 4);
  store<i32>(neighbours, w2 > 0 ? i2 : 0, 8);
  store<i32>(neighbours, w3 > 0 ? i3 : 0, 12);
}

/** As `levelsOf`: write order u32 [count], neighbors u32 [count, 4] and weights u16 [count, 4] of quantized positions i32 [count, 3]. The last two must be zeros. */
export function levels(quantized: usize, count: i32, firstStride: i32, order: usize, neighbours: usize, weights: usize): void {
  let at: usize = 0;
  for (let i = 0; i < count; i += firstStride, at++) store<i32>(order + 4 * at, i);
  for (let stride = firstStride; stride > 1; stride >>= 1) {
    for (let i = stride >> 1; i < count; i += stride, at++) {
      store<i32>(order + 4 * at, i);
      nearest(quantized, count, i, stride, neighbours + 16 * at, weights + 8 * at);
    }
  }
}
