/** Checks of JSON fields of a manifest. Each throws `ReelError` that names the field. */
import { ReelError } from "../base/errors";

/** A JSON object. */
export type Json = Record<string, unknown>;

/** Upper bound of the numbers of frames and groups. */
export const MAX_NUMBER = 2 ** 40;
/** Upper bound of numbers that are stored as float32. */
const FLOAT32 = 3e38;
/** Limits of JSON texts: nesting, and number of values. */
const MAX_DEPTH = 64;
const MAX_VALUES = 2_000_000;
/** A surrogate without its other half. */
const LONE_SURROGATE = /\p{Surrogate}/u;
/** A path within the reel: no other host, no parent folder, no hidden file. */
const PLAIN_PATH = /^[A-Za-z0-9_][A-Za-z0-9_.-]*(\/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$/;

/** Return the value of a JSON text. Throws for other text, half a character, infinite numbers, and too many or too deeply nested values. */
export function parseJson(text: string): unknown {
  const value: unknown = JSON.parse(text);
  let count = 0;
  const check = (part: unknown, depth: number): void => {
    if (++count > MAX_VALUES) throw new ReelError(`it holds more than ${MAX_VALUES} values`);
    if (typeof part === "number" && !Number.isFinite(part)) throw new ReelError("it holds an infinite number");
    if (typeof part === "string" && LONE_SURROGATE.test(part)) throw new ReelError("it holds half a character");
    if (typeof part !== "object" || part === null) return;
    if (depth === MAX_DEPTH) throw new ReelError(`it is nested more than ${MAX_DEPTH} deep`);
    if (LONE_SURROGATE.test(Object.keys(part).join(" "))) throw new ReelError("it holds half a character");
    for (const item of Object.values(part)) check(item, depth + 1);
  };
  check(value, 0);
  return value;
}

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

/** Return the value if it is a number from low to high. */
export function within(value: unknown, low: number, high: number, what: string): number {
  const result = number(value, what);
  if (result < low || result > high)
    throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected ${low} to ${high}.`);
  return result;
}

/** Return the value if it is an integer from low to high. */
export function whole(value: unknown, low: number, high: number, what: string): number {
  const result = within(value, low, high, what);
  if (!Number.isInteger(result))
    throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected a whole number.`);
  return result;
}

/** Return the value if it is a list of `count` numbers within the range of float32. */
export function numbers(value: unknown, count: number, what: string): number[] {
  const result = list(value, what);
  if (result.length !== count)
    throw new ReelError(`The manifest is damaged: ${what} has ${result.length} numbers, not ${count}.`);
  return result.map((item) => within(item, -FLOAT32, FLOAT32, what));
}

/** Return the value if it is true or false. absent: value if there is none; undefined if there must be one. */
export function flag(value: unknown, what: string, absent?: boolean): boolean {
  const result = value === undefined ? absent : value;
  if (typeof result !== "boolean")
    throw new ReelError(`The manifest is damaged: ${what} is ${JSON.stringify(value)}, expected true or false.`);
  return result;
}

/** Return the value if it is a SHA-256 digest, 64 hexadecimal digits. */
export function digest(value: unknown): string {
  if (typeof value !== "string" || !/^[0-9a-f]{64}$/.test(value)) {
    throw new ReelError(
      `The manifest is damaged: a file has the sha256 ${JSON.stringify(value)?.slice(0, 100)}, expected 64 hexadecimal digits.`,
    );
  }
  return value;
}

/** Return a field that is a text of at most `most` characters; "" if it is absent. */
export function shortText(json: Json, name: string, most: number): string {
  const { [name]: value = "" } = json;
  if (typeof value !== "string" || [...value].length > most)
    throw new ReelError(`The manifest is damaged: its ${name} is not a text of at most ${most} characters.`);
  return value;
}

/** Return the value if it is a path within the reel. */
export function plainPath(value: unknown): string {
  if (typeof value !== "string" || value.length > 500 || !PLAIN_PATH.test(value)) {
    throw new ReelError(
      `The manifest is damaged: it names the file ${JSON.stringify(value)?.slice(0, 100)}; only plain relative paths are read.`,
    );
  }
  return value;
}

/** Return the address of a file of the reel whose manifest is at `manifest`, with its query, such as a signature. Throws `ReelError` unless the path lies within the reel. */
export function addressWithin(manifest: string, uri: unknown): string {
  const address = new URL(plainPath(uri), manifest);
  address.search = new URL(manifest).search;
  return address.href;
}
