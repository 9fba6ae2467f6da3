/** Decoding of `linear`, `vq` and `bits` sections: packed integers, optionally deflated (docs/format.md). */
import { ReelError, inSection, messageOf } from "../base/errors";
import type { Container, Section } from "../reel/container";

/** Maximum number of static points of a reel. */
export const MAX_STATIC = 2 ** 26;
/** Maximum of the binary logarithms of values, and of their negatives. */
const MAX_LOG = 126;

/** Return the bytes of `count` packed integers of `bits` bits. */
export function packedSize(count: number, bits: number): number {
  return bits > 8 ? count + Math.ceil((count * (bits - 8)) / 8) : Math.ceil((count * bits) / 8);
}

/** Unpack integers of 1 to 16 bits: first the low bytes of all, then the higher bits without gaps, lowest bit first. */
export function unpack(data: Uint8Array, bits: number, count: number): Uint16Array {
  const result = new Uint16Array(count);
  let shift = 0;
  if (bits > 8) {
    for (let i = 0; i < count; i++) result[i] = data[i];
    data = data.subarray(count);
    bits -= 8;
    shift = 8;
  }
  const mask = (1 << bits) - 1;
  for (let i = 0, bit = 0; i < count; i++, bit += bits) {
    const at = bit >> 3;
    const pair = data[at] | ((data[at + 1] ?? 0) << 8);
    result[i] |= ((pair >> (bit & 7)) & mask) << shift;
  }
  return result;
}

/** Decompress zlib data if `deflated`. The result has `size` bytes, or fewer if not `exact`. */
export async function inflate(data: Uint8Array, deflated: boolean, size: number, exact = true): Promise<Uint8Array> {
  if (deflated) data = await inflateUpTo(data, size);
  if (data.byteLength > size || (exact && data.byteLength < size))
    throw new ReelError(`it holds ${data.byteLength} bytes, expected ${size}`);
  return data;
}

/** Decompress, but stop after `size` bytes, since a small stream may expand to gigabytes. */
async function inflateUpTo(data: Uint8Array, size: number): Promise<Uint8Array> {
  const reader = new Blob([data as BlobPart]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  const parts: Uint8Array[] = [];
  let length = 0;
  while (length <= size) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      throw new ReelError(`it is not a zlib stream (${messageOf(error)})`);
    });
    if (done) break;
    parts.push(value);
    length += value.byteLength;
  }
  if (length > size) await reader.cancel();
  const result = new Uint8Array(length);
  let at = 0;
  for (const part of parts) {
    result.set(part, at);
    at += part.byteLength;
  }
  return result;
}

/** Return the integers [count] of a section, column by column. */
export async function integers(file: Container, name: string, bits: number, count: number): Promise<Uint16Array> {
  return inSection(name, async () => {
    const plain = await inflate(
      tensor(file, name),
      flagOf(file.sections[name], "deflate", false),
      packedSize(count, bits),
    );
    return unpack(plain, bits, count);
  });
}

/** Decode the values [rows, columns] of a `linear` section. */
export async function linear(file: Container, name: string, rows: number, columns: number): Promise<Float32Array> {
  const section = sectionOf(file, name, "linear");
  const bits = await inSection(name, () => whole(section, "bits", 1, 16));
  const low = await inSection(name, () => numbersOf(section, "min", columns));
  const high = await inSection(name, () => numbersOf(section, "max", columns));
  const log = await inSection(name, () => flagOf(section, "log", false));
  if (log && [...low, ...high].some((value) => Math.abs(value) > MAX_LOG))
    throw new ReelError(`section ${name}: it has logarithms that no float32 holds`);
  const q = await integers(file, name, bits, rows * columns);
  const values = new Float32Array(rows * columns);
  for (let c = 0; c < columns; c++) {
    const step = (high[c] - low[c]) / ((1 << bits) - 1);
    for (let r = 0; r < rows; r++) {
      const value = low[c] + q[c * rows + r] * step;
      values[r * columns + c] = log ? 2 ** value : value;
    }
  }
  return values;
}

/** Decode the flags [count], 0 or 1, of a `bits` section. */
export async function flags(file: Container, name: string): Promise<Uint8Array> {
  const section = sectionOf(file, name, "bits");
  const count = await inSection(name, () => whole(section, "count", 0, MAX_STATIC));
  return Uint8Array.from(await integers(file, name, 1, count));
}

/** Return an integer parameter of a section. */
export function whole(section: Section, name: string, low: number, high: number): number {
  const value = section[name];
  if (!Number.isInteger(value) || (value as number) < low || (value as number) > high) {
    throw new ReelError(`its ${name} is ${short(value)}, not an integer from ${low} to ${high}`);
  }
  return value as number;
}

/** Return a parameter that is true or false. absent: value if there is none; undefined if there must be one. */
export function flagOf(section: Section, name: string, absent?: boolean): boolean {
  const { [name]: value = absent } = section;
  if (typeof value !== "boolean") throw new ReelError(`its ${name} is ${short(value)}, not true or false`);
  return value;
}

/** Return a parameter that is a list of numbers within the range of float32. */
export function numbersOf(section: Section, name: string, count: number): number[] {
  const value = section[name];
  if (
    !Array.isArray(value) ||
    value.length !== count ||
    !value.every((item) => typeof item === "number" && Math.abs(item) <= 3e38)
  ) {
    throw new ReelError(`its ${name} is ${short(value)}, not ${count} numbers`);
  }
  return value as number[];
}

/** Return a value as JSON of at most 60 characters, for messages. */
export function short(value: unknown): string {
  return (JSON.stringify(value) ?? "missing").slice(0, 60);
}

/** Return the parameters of a section, if it has the expected codec. */
export function sectionOf(file: Container, name: string, codec: string): Section {
  const section = file.sections[name];
  if (!section) throw new ReelError(`it has no section ${name}`);
  if (section.codec !== codec) {
    throw new ReelError(`section ${name} has the codec ${short(section.codec)}; this player knows ${codec}`);
  }
  return section;
}

/** Return the data of a section. */
export function tensor(file: Container, name: string): Uint8Array {
  const found = file.data[name];
  if (!found) throw new ReelError(`it has no data for section ${name}`);
  return found;
}
