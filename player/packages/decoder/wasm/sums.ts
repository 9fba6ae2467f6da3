/** Reconstruction of a `klt` section in WebAssembly: twins of ../src/decode/klt.ts. */

@external("env", "sin") declare function sin(x: f64): f64;
@external("env", "cos") declare function cos(x: f64): f64;

/** own f64 [rows, 4]: the first `end` i32 coefficients of a point at their slots, i32 [end], and zeros. */
function gather(from: usize, end: i32, slots: usize, rows: i32, own: usize): void {
  memory.fill(own, 0, 32 * rows);
  for (let at = 0; at < end; at++) store<f64>(own + 8 * load<i32>(slots + 4 * at), <f64>load<i32>(from + 4 * at));
}

@inline function narrowed(low: v128, high: v128): v128 {
  return v128.shuffle<f32>(f32x4.demote_f64x2_zero(low), f32x4.demote_f64x2_zero(high), 0, 1, 4, 5);
}

/**
 * result f32 [D, count, 4] of `count` points u32: sums over k of basis f64 [D, K] times found i32 [N, columns], 3 or 4 channels. ends: i32 [N];
 * slots i32 [columns], rows i32 [columns + 1]: see slotsOf; own: f64 [K, 4], scratch.
 */
export function expand(found: usize, ends: usize, points: usize, count: i32, columns: i32, slots: usize, rows: usize, basis: usize, dimensions: i32, K: i32, own: usize, result: usize): void {
  const across = 16 * count;
  const last = dimensions - 1;
  for (let n = 0; n < count; n++, result += 16) {
    const point = load<u32>(points + 4 * n);
    const end = load<i32>(ends + 4 * point);
    const used = load<i32>(rows + 4 * end);
    gather(found + 4 * columns * point, end, slots, used, own);
    // Four dimensions at a time: what is read of the point serves all. The last may come twice.
    for (let first = 0; first < dimensions; first += 4) {
      const d = max<i32>(min<i32>(first, dimensions - 4), 0);
      const d1 = min<i32>(d + 1, last);
      const d2 = min<i32>(d + 2, last);
      const d3 = min<i32>(d + 3, last);
      let a = basis + 8 * d * K;
      const a1 = 8 * (d1 - d) * K;
      const a2 = 8 * (d2 - d) * K;
      const a3 = 8 * (d3 - d) * K;
      let s = f64x2.splat(0), t = s, s1 = s, t1 = s, s2 = s, t2 = s, s3 = s, t3 = s;
      for (let at = own, end = own + 32 * used; at < end; at += 32, a += 8) {
        const v = v128.load(at);
        const w = v128.load(at, 16);
        const b = v128.load_splat<f64>(a);
        s = f64x2.add(s, f64x2.mul(b, v));
        t = f64x2.add(t, f64x2.mul(b, w));
        const b1 = v128.load_splat<f64>(a + a1);
        s1 = f64x2.add(s1, f64x2.mul(b1, v));
        t1 = f64x2.add(t1, f64x2.mul(b1, w));
        const b2 = v128.load_splat<f64>(a + a2);
        s2 = f64x2.add(s2, f64x2.mul(b2, v));
        t2 = f64x2.add(t2, f64x2.mul(b2, w));
        const b3 = v128.load_splat<f64>(a + a3);
        s3 = f64x2.add(s3, f64x2.mul(b3, v));
        t3 = f64x2.add(t3, f64x2.mul(b3, w));
      }
      v128.store(result + across * d, narrowed(s, t));
      v128.store(result + across * d1, narrowed(s1, t1));
      v128.store(result + across * d2, narrowed(s2, t2));
      v128.store(result + across * d3, narrowed(s3, t3));
    }
  }
}

/** result f32 [count, D], D at least 8: as above for one channel, whose columns are the vectors; basis: f64 [K, D]. */
export function expandRows(found: usize, ends: usize, points: usize, count: i32, columns: i32, basis: usize, dimensions: i32, result: usize): void {
  for (let n = 0; n < count; n++, result += 4 * dimensions) {
    const point = load<u32>(points + 4 * n);
    const used = load<i32>(ends + 4 * point);
    const from = found + 4 * columns * point;
    for (let first = 0; first < dimensions; first += 8) {
      const d = min<i32>(first, dimensions - 8);
      let s = f64x2.splat(0), s1 = s, s2 = s, s3 = s;
      let a = basis + 8 * d;
      for (let k = 0; k < used; k++, a += 8 * dimensions) {
        const v = f64x2.splat(<f64>load<i32>(from + 4 * k));
        s = f64x2.add(s, f64x2.mul(v128.load(a), v));
        s1 = f64x2.add(s1, f64x2.mul(v128.load(a, 16), v));
        s2 = f64x2.add(s2, f64x2.mul(v128.load(a, 32), v));
        s3 = f64x2.add(s3, f64x2.mul(v128.load(a, 48), v));
      }
      v128.store(result + 4 * d, narrowed(s, s1));
      v128.store(result + 4 * d, narrowed(s2, s3), 16);
    }
  }
}

/** Convert rotation vectors (x, y, z, 0) f32 [count, 4] to quaternions (w, x, y, z), in place. */
export function turn(values: usize, count: i32): void {
  for (const end = values + 16 * count; values < end; values += 16) {
    const x = <f64>load<f32>(values);
    const y = <f64>load<f32>(values, 4);
    const z = <f64>load<f32>(values, 8);
    const angle = sqrt<f64>(x * x + y * y + z * z);
    const share = angle > 1e-12 ? sin(angle / 2) / angle : 0.5;
    store<f32>(values, <f32>cos(angle / 2));
    store<f32>(values, <f32>(x * share), 4);
    store<f32>(values, <f32>(y * share), 8);
    store<f32>(values, <f32>(z * share), 12);
  }
}

/** Convert (b, r, g, o) f32 [count, 4] to red, green, blue and o / 2, in place. shares: f64 [3]. */
export function color(values: usize, count: i32, shares: usize): void {
  const b = load<f64>(shares);
  const r = load<f64>(shares, 8);
  const g = load<f64>(shares, 16);
  for (const end = values + 16 * count; values < end; values += 16) {
    const bright = <f64>load<f32>(values) * b;
    const red = <f64>load<f32>(values, 4) * r;
    const green = <f64>load<f32>(values, 8) * g;
    store<f32>(values, <f32>(bright + red - green));
    store<f32>(values, <f32>(bright + 2 * green), 4);
    store<f32>(values, <f32>(bright - red - green), 8);
    store<f32>(values, load<f32>(values, 12) / 2, 12);
  }
}

/** Widen the ranges f32 [2, 4] (minimum, maximum) by values f32 [count, 4]. */
export function range(values: usize, count: i32, ranges: usize): void {
  let low = v128.load(ranges);
  let high = v128.load(ranges, 16);
  for (const end = values + 16 * count; values < end; values += 16) {
    const value = v128.load(values);
    low = f32x4.pmin(low, value);
    high = f32x4.pmax(high, value);
  }
  v128.store(ranges, low);
  v128.store(ranges, high, 16);
}

/**
 * data [frames, rows, 4] of u16, or of u8 where bytes is 4, becomes `stay`, and at the `count` points (value - least) * share, rounded. values: f32
 * [frames, count, 4]; scale: f64 [2, 4] (least, share).
 */
export function quantize(values: usize, frames: i32, points: usize, count: i32, rows: i32, scale: usize, stay: usize, data: usize, bytes: i32): void {
  if (count < rows) {
    const end = data + bytes * rows * frames;
    if (bytes == 8) for (let at = data; at < end; at += 8) store<u64>(at, load<u64>(stay));
    else for (let at = data; at < end; at += 4) store<u32>(at, load<u32>(stay));
  }
  const a = v128.load(scale);
  const b = v128.load(scale, 16);
  const p = v128.load(scale, 32);
  const q = v128.load(scale, 48);
  for (let t = 0; t < frames; t++, data += bytes * rows) {
    for (let n = 0; n < count; n++, values += 16) {
      const to = data + bytes * load<u32>(points + 4 * n);
      const texel = rounded(v128.load(values), a, b, p, q);
      const half = i16x8.narrow_i32x4_u(texel, texel);
      if (bytes == 8) v128.store_lane<u64>(to, half, 0);
      else v128.store_lane<u32>(to, i8x16.narrow_i16x8_u(half, half), 0);
    }
  }
}

@inline function rounded(value: v128, a: v128, b: v128, p: v128, q: v128): v128 {
  const half = f64x2.splat(0.5);
  const low = f64x2.promote_low_f32x4(value);
  const high = f64x2.promote_low_f32x4(v128.shuffle<f64>(value, value, 1, 1));
  const x = i32x4.trunc_sat_f64x2_u_zero(f64x2.add(f64x2.mul(f64x2.sub(low, a), p), half));
  const y = i32x4.trunc_sat_f64x2_u_zero(f64x2.add(f64x2.mul(f64x2.sub(high, b), q), half));
  return v128.shuffle<i32>(x, y, 0, 1, 4, 5);
}
