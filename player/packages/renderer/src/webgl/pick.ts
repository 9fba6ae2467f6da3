/** Depth at a pixel, from the splats that the projection pass wrote (shaders.ts). */

/** A splat at a pixel. */
export interface Hit {
  depth: number;
  alpha: number;
}

/** Return the splats that cover a pixel. shape, color: [N, 4] words of the splat target. */
export function hitsAt(shape: Uint32Array, color: Uint32Array, x: number, y: number): Hit[] {
  const shapes = new Float32Array(shape.buffer);
  const colors = new Float32Array(color.buffer);
  const hits: Hit[] = [];
  for (let at = 0; at < shape.length; at += 4) {
    const extent = colors[at + 2];
    if (!(extent > 0)) continue;
    const dx = x - shapes[at];
    const dy = y - shapes[at + 1];
    // The axes end with the splat, at `extent` standard deviations.
    const u = along(shape[at + 2], dx, dy);
    const v = along(shape[at + 3], dx, dy);
    const square = (u * u + v * v) * extent * extent;
    if (square < extent * extent)
      hits.push({ depth: colors[at + 3], alpha: float(color[at + 1] >>> 16) * Math.exp(-0.5 * square) });
  }
  return hits;
}

/** Return the depth of the hit at which a share of the light is absorbed, 0 to 1; null if less is. */
export function depthOf(hits: Hit[], share: number): number | null {
  let light = 1;
  for (const { depth, alpha } of hits.sort((a, b) => a.depth - b.depth)) {
    light *= 1 - alpha;
    if (light < 1 - share) return depth;
  }
  return null;
}

/** Project a vector onto an axis of two packed half-precision numbers, in units of its length. */
function along(packed: number, dx: number, dy: number): number {
  const [x, y] = [float(packed & 0xffff), float(packed >>> 16)];
  return (x * dx + y * dy) / Math.max(x * x + y * y, 1e-12);
}

/** Return the value of a half-precision number. */
export function float(bits: number): number {
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  const size = exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25);
  return bits & 0x8000 ? -size : size;
}
