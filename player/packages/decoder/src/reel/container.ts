/** Parsing of safetensors files with a `splatreel` header (docs/format.md). */
import { PLAIN, ReelError } from "../base/errors";
import { fits } from "./budget";

/** Parameters of a section, not checked yet. */
export interface Section {
  codec: string;
  [parameter: string]: unknown;
}

/** A tensor of the file. */
export interface Tensor {
  dtype: string;
  shape: number[];
  bytes: Uint8Array;
}

/** A parsed file. */
export interface Container {
  kind: "layer" | "group";
  index: number;
  points: number;
  /** Number of frames of a group; 0 for a layer. */
  frames: number;
  sections: Record<string, Section>;
  tensors: Record<string, Tensor>;
}

const ITEM_BYTES: Record<string, number> = { U8: 1, I8: 1, BOOL: 1, U16: 2, I16: 2, F16: 2, U32: 4, I32: 4, F32: 4, F64: 8, I64: 8, U64: 8 };

/** Split a file into its sections. Throws `ReelError` that names the file if it is damaged. */
export function parseContainer(file: Uint8Array, name: string): Container {
  const fail = (why: string): never => {
    throw new ReelError(`${name} is damaged: ${why}. Reload, or encode the reel again.`);
  };
  if (file.byteLength < 8) fail("it is too short for a header");
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  const headerBytes = view.getUint32(0, true) + view.getUint32(4, true) * 2 ** 32;
  if (headerBytes > file.byteLength - 8) fail("its header is cut off");
  let header: unknown;
  let meta: unknown;
  try {
    header = JSON.parse(new TextDecoder().decode(file.subarray(8, 8 + headerBytes)));
    meta = JSON.parse((header as { __metadata__: { splatreel: string } }).__metadata__.splatreel);
  } catch {
    fail("its header cannot be read");
  }
  if (!isObject(header) || !isObject(meta)) return fail("its header cannot be read");
  if (meta.version !== 1) throw new ReelError(`${name} has version ${JSON.stringify(meta.version)}; this player knows version 1.`, { plain: PLAIN.newer });
  const sections = meta.sections;
  if (!isObject(sections) || !Object.values(sections).every(isObject)) return fail("it has no sections");
  if (meta.kind !== "layer" && meta.kind !== "group") fail("it is neither a layer nor a group");
  if (!isCount(meta.points) || (meta.kind === "group" && !isCount(meta.frames))) fail("its number of points or frames is invalid");
  const frames = meta.kind === "group" ? (meta.frames as number) : 0;
  if (!fits(meta.points as number, frames, sections as Record<string, Section>, file.byteLength)) {
    fail(`it claims ${frames} frames of ${meta.points} points in ${file.byteLength} bytes, which would take too much memory`);
  }
  const body = file.subarray(8 + headerBytes);
  const tensors: Record<string, Tensor> = {};
  for (const [key, value] of Object.entries(header)) {
    if (key === "__metadata__") continue;
    const { dtype, shape, data_offsets: offsets } = (isObject(value) ? value : {}) as { dtype?: unknown; shape?: unknown; data_offsets?: unknown };
    if (typeof dtype !== "string" || !Array.isArray(shape) || !Array.isArray(offsets)) return fail(`section ${key} has no data offsets`);
    const [begin, end] = offsets;
    const size = shape.reduce((product, side) => product * side, ITEM_BYTES[dtype] ?? NaN);
    if (!(Number.isInteger(begin) && Number.isInteger(end) && begin >= 0 && end <= body.byteLength && end - begin === size)) fail(`section ${key} does not fit the file`);
    tensors[key] = { dtype, shape, bytes: body.subarray(begin, end) };
  }
  return {
    kind: meta.kind as "layer" | "group",
    index: meta.index as number,
    points: meta.points as number,
    frames: (meta.frames ?? 0) as number,
    sections: sections as Record<string, Section>,
    tensors,
  };
}

const MAX_POINTS = 2 ** 23;

function isCount(value: unknown): boolean {
  return Number.isInteger(value) && (value as number) >= 0 && (value as number) <= MAX_POINTS;
}

function isObject(value: unknown): value is Record<string, unknown> {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}
