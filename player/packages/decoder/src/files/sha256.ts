/** SHA-256 (FIPS 180-4) for pages without `crypto.subtle`, which browsers offer in secure contexts only. */

/** First eight hash values and 64 round constants: fractions of the square and cube roots of the first primes. */
const START = new Int32Array(8);
const ROUND = new Int32Array(64);
for (let prime = 2, count = 0; count < 64; prime++) {
  if (Array.from({ length: prime - 2 }, (_, i) => i + 2).some((factor) => prime % factor === 0)) continue;
  if (count < 8) START[count] = fraction(Math.sqrt(prime));
  ROUND[count++] = fraction(Math.cbrt(prime));
}

/** Return the digest of bytes in hexadecimal. */
export function sha256(bytes: Uint8Array): string {
  const state = Int32Array.from(START);
  const words = new Int32Array(64);
  const whole = bytes.byteLength & -64;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  for (let at = 0; at < whole; at += 64) addBlock(state, words, view, at);
  // The last block or two: the rest of the bytes, a one, zeros, and the number of bits.
  const rest = bytes.subarray(whole);
  const tail = new Uint8Array(rest.byteLength < 56 ? 64 : 128);
  tail.set(rest);
  tail[rest.byteLength] = 128;
  const end = new DataView(tail.buffer);
  end.setBigUint64(tail.byteLength - 8, BigInt(bytes.byteLength) * 8n);
  for (let at = 0; at < tail.byteLength; at += 64) addBlock(state, words, end, at);
  return Array.from(state, (word) => (word >>> 0).toString(16).padStart(8, "0")).join("");
}

/** Add the block of 64 bytes at an offset to the state. words: space for the 64 words of the block. */
function addBlock(state: Int32Array, words: Int32Array, data: DataView, at: number): void {
  for (let i = 0; i < 16; i++) words[i] = data.getInt32(at + 4 * i);
  for (let i = 16; i < 64; i++) {
    const [early, late] = [words[i - 15], words[i - 2]];
    const small = turn(early, 7) ^ turn(early, 18) ^ (early >>> 3);
    const large = turn(late, 17) ^ turn(late, 19) ^ (late >>> 10);
    words[i] = words[i - 16] + small + words[i - 7] + large;
  }
  let [a, b, c, d, e, f, g, h] = state;
  for (let i = 0; i < 64; i++) {
    const first = (h + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + ROUND[i] + words[i]) | 0;
    const second = ((turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
    h = g;
    g = f;
    f = e;
    e = (d + first) | 0;
    d = c;
    c = b;
    b = a;
    a = (first + second) | 0;
  }
  [a, b, c, d, e, f, g, h].forEach((word, i) => (state[i] += word));
}

function turn(word: number, bits: number): number {
  return (word >>> bits) | (word << (32 - bits));
}

/** Return the first 32 bits of the fraction. */
function fraction(root: number): number {
  return ((root % 1) * 2 ** 32) | 0;
}
