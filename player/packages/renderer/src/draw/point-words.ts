/** Points of a file as numbers of textures: rows of `TEXTURE_WIDTH` points, as the shaders read them (webgl/point-shaders.ts). */
import type { Gaussians } from "@splatreel/decoder/internal";
import { TEXTURE_WIDTH } from "./texture-layout";

/** Texels per point, one per layer of the texture, and per codebook entry: one per coefficient. */
export const POINT_TEXELS = 3;
export const ENTRY_TEXELS = 15;
export const ENTRIES_PER_ROW = 128;

/** Return the number of texture rows of `count` points. */
export function rowsOf(count: number): number {
  return Math.ceil(count / TEXTURE_WIDTH);
}

/** Return the words [3, rows, 1024, 4] of points. */
export function packPoints(points: Gaussians): Uint32Array<ArrayBuffer> {
  const rows = rowsOf(points.count);
  const layer = rows * TEXTURE_WIDTH * 4;
  const words = new Uint32Array(POINT_TEXELS * layer);
  const floats = new Float32Array(words.buffer);
  const { means, quats, scales, opacities, shBase, shRest } = points;
  for (let i = 0; i < points.count; i++) {
    let at = 4 * i;
    for (let a = 0; a < 3; a++) floats[at + a] = means[3 * i + a];
    words[at + 3] = shRest[i];
    at += layer;
    for (let a = 0; a < 3; a++) floats[at + a] = scales[3 * i + a];
    words[at + 3] = halves(opacities[i], shBase[3 * i]);
    at += layer;
    words[at] = halves(quats[4 * i], quats[4 * i + 1]);
    words[at + 1] = halves(quats[4 * i + 2], quats[4 * i + 3]);
    words[at + 2] = halves(shBase[3 * i + 1], shBase[3 * i + 2]);
  }
  return words;
}

/** Return the view-dependent colors of a file as [rows, 128 * 15, 4] numbers, and the number of entries. */
export function packCodebook({ codebook, shDegree }: Gaussians): {
  values: Float32Array<ArrayBuffer>;
  rows: number;
  entries: number;
} {
  const numbers = 3 * ((shDegree + 1) ** 2 - 1);
  const entries = codebook.length / numbers;
  const rows = Math.ceil(entries / ENTRIES_PER_ROW);
  const values = new Float32Array(rows * ENTRIES_PER_ROW * ENTRY_TEXELS * 4);
  for (let e = 0; e < entries; e++) {
    for (let i = 0; i < numbers; i++) {
      values[4 * (e * ENTRY_TEXELS + Math.floor(i / 3)) + (i % 3)] = codebook[e * numbers + i];
    }
  }
  return { values, rows, entries };
}

/** Return flags [N] as whole rows. */
export function packFlags(flags: Uint8Array): Uint8Array<ArrayBuffer> {
  const padded = new Uint8Array(rowsOf(flags.length) * TEXTURE_WIDTH);
  padded.set(flags);
  return padded;
}

const float = new Float32Array(1);
const bits = new Uint32Array(float.buffer);

/** Return the bits of the nearest half-precision number. */
export function half(value: number): number {
  float[0] = value;
  const x = bits[0];
  const sign = (x >>> 16) & 0x8000;
  const magnitude = x & 0x7fffffff;
  if (magnitude >= 0x47800000) return sign | 0x7bff; // clamp to the largest half
  if (magnitude < 0x38800000) {
    // Subnormal: a multiple of 2^-24.
    return sign | Math.round(Math.abs(value) * 2 ** 24);
  }
  return Math.min((sign | ((magnitude - 0x38000000 + 0x1000) >>> 13)) & 0xffff, sign | 0x7bff);
}

function halves(low: number, high: number): number {
  return (half(low) | (half(high) << 16)) >>> 0;
}
