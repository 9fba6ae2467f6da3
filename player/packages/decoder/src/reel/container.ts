/** Parsing of safetensors files with a `splatreel` header (docs/format.md). */
import { PLAIN, ReelError } from "../base/errors";
import { fits } from "./budget";
import { MAX_NUMBER, parseJson } from "./json";
import { utf8 } from "../base/text";

/** Maximum bytes of the header. */
const MAX_HEADER = 2 ** 20;

/** Parameters of a section, not checked yet. */
export interface Section {
  codec: string;
  [parameter: string]: unknown;
}

/** A parsed file. */
export interface Container {
  kind: "layer" | "group";
  index: number;
  points: number;
  firstFrame: number;
  /** Number of frames of a group; 0 for a layer. */
  frames: number;
  sections: Record<string, Section>;
  /** Data of the sections. */
  data: Record<string, Uint8Array>;
}

/** Split a file into its sections. Throws `ReelError` that names the file if it is damaged. */
export function parseContainer(file: Uint8Array, name: string): Container {
  const fail = (why: string): never => {
    throw new ReelError(`${name} is damaged: ${why}. Reload, or encode the reel again.`);
  };
  if (file.byteLength < 8) fail("it is too short for a header");
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  const headerBytes = view.getUint32(0, true) + view.getUint32(4, true) * 2 ** 32;
  if (headerBytes > Math.min(file.byteLength - 8, MAX_HEADER)) fail("its header is cut off");
  let header: unknown;
  let meta: unknown;
  try {
    header = parseJson(utf8(file.subarray(8, 8 + headerBytes)));
    meta = parseJson((header as { __metadata__: { splatreel: string } }).__metadata__.splatreel);
  } catch {
    fail("its header cannot be read");
  }
  if (!isObject(header) || !isObject(meta)) return fail("its header cannot be read");
  if (meta.version !== 1)
    throw new ReelError(`${name} has version ${JSON.stringify(meta.version)}; this player knows version 1.`, {
      plain: PLAIN.newer,
    });
  const sections = meta.sections;
  if (!isObject(sections) || !Object.values(sections).every(isObject)) return fail("it has no sections");
  if (meta.kind !== "layer" && meta.kind !== "group") fail("it is neither a layer nor a group");
  const frames = meta.kind === "group" ? (meta.frames as number) : 0;
  if (![meta.points, frames, meta.index, meta.first_frame].every(isCount) || (meta.kind === "group" && frames === 0))
    fail("its number of points or frames, or its place, is invalid");
  if (!fits(meta.points as number, frames, sections as Record<string, Section>, file.byteLength)) {
    fail(
      `it claims ${frames} frames of ${meta.points} points in ${file.byteLength} bytes, which would take too much memory`,
    );
  }
  const body = file.subarray(8 + headerBytes);
  const data: Record<string, Uint8Array> = {};
  for (const name of Object.keys(sections)) {
    const tensor = header[name];
    if (!isObject(tensor) || tensor.dtype !== "U8") return fail(`section ${name} is not a tensor of bytes`);
    const { shape, data_offsets: offsets } = tensor;
    const [begin, end] = Array.isArray(offsets) && offsets.length === 2 ? (offsets as unknown[]) : [];
    const inside =
      isCount(begin) &&
      isCount(end) &&
      begin <= end &&
      end <= body.byteLength &&
      JSON.stringify(shape) === `[${end - begin}]`;
    if (!inside) return fail(`section ${name} does not fit the file`);
    data[name] = body.subarray(begin, end);
  }
  return {
    kind: meta.kind as "layer" | "group",
    index: meta.index as number,
    points: meta.points as number,
    firstFrame: meta.first_frame as number,
    frames,
    sections: sections as Record<string, Section>,
    data,
  };
}

function isCount(value: unknown): value is number {
  return Number.isInteger(value) && (value as number) >= 0 && (value as number) <= MAX_NUMBER;
}

function isObject(value: unknown): value is Record<string, unknown> {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}
