/** Checks of JSON fields of a manifest. Each throws `ReelError` that names the field. */
import { ReelError } from "../base/errors";

/** A JSON object. */
export type Json = Record<string, unknown>;

/** A path within the reel: no other host, no parent folder, no hidden file. */
const PLAIN_PATH = /^[A-Za-z0-9_][A-Za-z0-9_.-]*(\/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$/;

/** Return the value if it is an object. */
export function record(value: unknown, what: string): Json {
  if (typeof value !== "object" || value === null || Array.isArray(value)) {
    throw new ReelError(`The manifest is damaged: ${what} is not an object.`);
  }
  return value as Json;
}

/** Return the value if it is a list. */
export function list(value: unknown, what: string): unknown[] {
  if (!Array.isArray(value)) throw new ReelError(`The manifest is damaged: ${what} is not a list.`);
  return value;
}

/** Return the value if it is a finite number. */
export function number(value: unknown, what: string): number {
  if (typeof value !== "number" || !Number.isFinite(value)) {
    throw new ReelError(`The manifest is damaged: ${what} is ${JSON.stringify(value)}, not a number.`);
  }
  return value;
}

/** Return the value if it is a number above 0. */
export function positive(value: unknown, what: string): number {
  const result = number(value, what);
  if (result <= 0) throw new ReelError(`The manifest is damaged: ${what} is ${result}.`);
  return result;
}

/** Return the value if it is a number from low to high. */
export function within(value: unknown, low: number, high: number, what: string): number {
  const result = number(value, what);
  if (result < low || result > high) throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected ${low} to ${high}.`);
  return result;
}

/** Return the value if it is an integer from low to high. */
export function whole(value: unknown, low: number, high: number, what: string): number {
  const result = within(value, low, high, what);
  if (!Number.isInteger(result)) throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected a whole number.`);
  return result;
}

/** Return the value as a flat list, if it holds `count` numbers. */
export function numbers(value: unknown, count: number, what: string): number[] {
  const result = list(value, what).flat();
  if (result.length !== count) throw new ReelError(`The manifest is damaged: ${what} has ${result.length} numbers, not ${count}.`);
  return result.map((item) => number(item, what));
}

/** Return the value if it is a path within the reel. */
export function plainPath(value: unknown): string {
  if (typeof value !== "string" || value.length > 500 || !PLAIN_PATH.test(value)) {
    throw new ReelError(`The manifest is damaged: it names the file ${JSON.stringify(value)?.slice(0, 100)}; only plain relative paths are read.`);
  }
  return value;
}

/** Return the address of a file of the reel whose manifest is at `manifest`. Throws `ReelError` unless the path lies within the reel. */
export function addressWithin(manifest: string, uri: unknown): string {
  return new URL(plainPath(uri), manifest).href;
}
