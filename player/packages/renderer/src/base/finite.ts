/** Check of numbers given by pages, as in HTMLMediaElement. */

/** Return a finite number, which may be given as a string. Throws `TypeError`. */
export function finite(value: number | string, what: string): number {
  const number = typeof value === "string" ? Number(value) : value;
  if (typeof number !== "number" || !Number.isFinite(number))
    throw new TypeError(`${what} must be a finite number, not ${String(value)}.`);
  return number;
}
