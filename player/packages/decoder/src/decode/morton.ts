/** Sorting of lattice points by Morton code (Z-order): bit 3b + a of a code is bit b of axis a. */

const DIGIT_BITS = 4;
const MAX_BITS = 21;

/** SPREAD[v]: the four bits of v with two zero bits between them. */
const SPREAD = Uint16Array.from(
  { length: 1 << DIGIT_BITS },
  (_, v) => (v & 1) | ((v & 2) << 2) | ((v & 4) << 4) | ((v & 8) << 6),
);

/**
 * Return the stable order [N] of lattice points [N, 3] (0 <= q < 2^21) by Morton code.
 * It is a radix sort with digits of four bits per axis, so that no 63-bit code is formed.
 */
export function mortonOrder(q: ArrayLike<number>): Uint32Array {
  const count = q.length / 3;
  let order = Uint32Array.from({ length: count }, (_, i) => i);
  let next = new Uint32Array(count);
  const digits = new Uint16Array(count);
  for (let shift = 0; shift < MAX_BITS; shift += DIGIT_BITS) {
    const starts = new Uint32Array((1 << (3 * DIGIT_BITS)) + 1);
    for (let i = 0; i < count; i++) {
      const x = SPREAD[(q[3 * i] >> shift) & 15];
      const y = SPREAD[(q[3 * i + 1] >> shift) & 15];
      const z = SPREAD[(q[3 * i + 2] >> shift) & 15];
      digits[i] = x | (y << 1) | (z << 2);
      starts[digits[i] + 1]++;
    }
    for (let d = 1; d < starts.length; d++) starts[d] += starts[d - 1];
    for (let i = 0; i < count; i++) next[starts[digits[order[i]]]++] = order[i];
    [order, next] = [next, order];
  }
  return order;
}
