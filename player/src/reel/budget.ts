/** How much memory decoding a file takes, by what it says of itself, and how much it may take: the same as in Python (docs/format.md). */

/** Bytes of memory that any file may take, and as many more for each byte of its length. */
const FLOOR = 2 ** 25;
const A_BYTE = 256;
/** Frames of one group. */
export const MOST_FRAMES = 10_000;

/** Points that files of so many bytes in all may hold. */
export function mostPoints(bytes: number): number {
  return bytes + FLOOR / A_BYTE;
}

/** Whether a file may take as much memory as its sections need. What is no number is refused later and counts as nothing. */
export function fits(points: number, frames: number, sections: Record<string, Record<string, unknown>>, bytes: number): boolean {
  const found = Object.entries(sections);
  const columns = found.map(([, section]) => (section.codec === "klt" ? whole(section.columns) : 0));
  const basis = found.map(([, { shifts }]) => (Array.isArray(shifts) ? shifts.length : 0));
  const degree = Math.min(whole(sections.sh_rest?.degree), 3);
  const aPoint = 256 + 32 * frames * (sections.shade ? 2 : 1) + 6 * Math.max(0, ...columns) + 18 * ((degree + 1) ** 2 - 1);
  const pictures = found.map(([name, { width, height }]) => whole(width) * whole(height) * (name === "offsets" ? 10 * frames : name === "sh_rest" ? 3 + 3 * (degree + 1) ** 2 : 3));
  const needed = points * aPoint + 32 * Math.max(0, ...basis) * Math.max(frames, 45) + 2 * pictures.reduce((sum, area) => sum + area, 0) + 2 * whole(sections.alive?.count);
  return needed <= FLOOR + A_BYTE * bytes;
}

function whole(value: unknown): number {
  return Number.isInteger(value) && (value as number) >= 0 && (value as number) <= 2 ** 26 ? (value as number) : 0;
}
