/** Memory limits for decoding a file, computed from its header as in Python (docs/format.md). */

/** Bytes of memory for any file, and additional bytes per byte of its length. */
const BASE = 2 ** 25;
const PER_BYTE = 256;
/** Maximum number of frames of a group. */
export const MAX_FRAMES = 10_000;

/** Return the maximum number of points in files of `bytes` bytes. */
export function maxPoints(bytes: number): number {
  return bytes + BASE / PER_BYTE;
}

/** Return true if the sections of a file fit the memory limit. Invalid numbers count as 0 and are rejected later. */
export function fits(
  points: number,
  frames: number,
  sections: Record<string, Record<string, unknown>>,
  bytes: number,
): boolean {
  const found = Object.entries(sections);
  const columns = found.map(([, section]) => (section.codec === "klt" ? whole(section.columns) : 0));
  const basis = found.map(([, { shifts }]) => (Array.isArray(shifts) ? shifts.length : 0));
  const degree = Math.min(whole(sections.sh_rest?.degree), 3);
  const perPoint =
    256 + 32 * frames * (sections.shade ? 2 : 1) + 6 * Math.max(0, ...columns) + 18 * ((degree + 1) ** 2 - 1);
  const pictures = found.map(
    ([name, { width, height }]) =>
      whole(width) *
      whole(height) *
      (name === "offsets" ? 10 * frames : name === "sh_rest" ? 3 + 3 * (degree + 1) ** 2 : 3),
  );
  const needed =
    points * perPoint +
    32 * Math.max(0, ...basis) * Math.max(frames, 45) +
    2 * pictures.reduce((sum, area) => sum + area, 0) +
    2 * whole(sections.alive?.count);
  return needed <= BASE + PER_BYTE * bytes;
}

function whole(value: unknown): number {
  return Number.isInteger(value) && (value as number) >= 0 && (value as number) <= 2 ** 26 ? (value as number) : 0;
}
