/** Fields of a manifest's JSON, checked. Each throws `ReelError` that names the field. */
import { ReelError } from "../base/errors";

export type Json = Record<string, unknown>;

/** Inside of the reel: no other host, no way up, nothing hidden. */
const PLAIN_PATH = /^[A-Za-z0-9_][A-Za-z0-9_.-]*(\/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$/;

export function record(value: unknown, what: string): Json {
  if (typeof value !== "object" || value === null || Array.isArray(value)) {
    throw new ReelError(`The manifest is damaged: ${what} is not an object.`);
  }
  return value as Json;
}

export function list(value: unknown, what: string): unknown[] {
  if (!Array.isArray(value)) throw new ReelError(`The manifest is damaged: ${what} is not a list.`);
  return value;
}

export function number(value: unknown, what: string): number {
  if (typeof value !== "number" || !Number.isFinite(value)) {
    throw new ReelError(`The manifest is damaged: ${what} is ${JSON.stringify(value)}, not a number.`);
  }
  return value;
}

export function positive(value: unknown, what: string): number {
  const result = number(value, what);
  if (result <= 0) throw new ReelError(`The manifest is damaged: ${what} is ${result}.`);
  return result;
}

export function within(value: unknown, low: number, high: number, what: string): number {
  const result = number(value, what);
  if (result < low || result > high) throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected ${low} to ${high}.`);
  return result;
}

export function whole(value: unknown, low: number, high: number, what: string): number {
  const result = within(value, low, high, what);
  if (!Number.isInteger(result)) throw new ReelError(`The manifest is damaged: ${what} is ${result}, expected a whole number.`);
  return result;
}

export function numbers(value: unknown, count: number, what: string): number[] {
  const result = list(value, what).flat();
  if (result.length !== count) throw new ReelError(`The manifest is damaged: ${what} has ${result.length} numbers, not ${count}.`);
  return result.map((item) => number(item, what));
}

/** A file's path within the reel. */
export function plainPath(value: unknown): string {
  if (typeof value !== "string" || value.length > 500 || !PLAIN_PATH.test(value)) {
    throw new ReelError(`The manifest is damaged: it names the file ${JSON.stringify(value)?.slice(0, 100)}; only plain relative paths are read.`);
  }
  return value;
}
