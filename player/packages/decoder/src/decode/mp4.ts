/** Parsing of HEVC tracks from a progressive or fragmented MP4 file. */
import { ReelError } from "../base/errors";

/** A video track. */
export interface Track {
  id: number;
  /** Handler name: "hi", "lo" or "rot". */
  name: string;
  width: number;
  height: number;
  /** Body of the hvcC box: parameter sets and the length size of the samples' NAL units. */
  hvcC: Uint8Array;
  samples: Uint8Array[];
}

interface Box {
  type: string;
  /** Offset of the body in the file, and of its end. */
  start: number;
  end: number;
  /** Offset of the box itself. */
  offset: number;
}

/** Return the tracks in file order. most: maximum samples per track, since a small file may claim billions. Throws `ReelError` if boxes are missing or point outside the file. */
export function parseMp4(file: Uint8Array, most: number): Track[] {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  try {
    const top = boxes(view, 0, view.byteLength);
    if (top.at(-1)?.end !== view.byteLength)
      throw new ReelError("The offset video of a group is not made of whole MP4 boxes.");
    const moov = find(top, "moov");
    const children = boxes(view, moov.start, moov.end);
    const tracks = children.filter((box) => box.type === "trak").map((box) => parseTrack(file, view, box, most));
    for (const moof of top.filter((box) => box.type === "moof")) addFragment(file, view, moof, tracks, most);
    return tracks;
  } catch (error) {
    if (error instanceof RangeError) throw new ReelError("The offset video of a group is cut off.");
    throw error;
  }
}

function boxes(view: DataView, start: number, end: number): Box[] {
  const result: Box[] = [];
  for (let at = start; at + 8 <= end;) {
    let size = view.getUint32(at);
    let head = 8;
    if (size === 1) {
      size = view.getUint32(at + 8) * 2 ** 32 + view.getUint32(at + 12);
      head = 16;
    }
    if (size < head || at + size > end) throw new ReelError("The offset video of a group is cut off.");
    const type = String.fromCharCode(...[4, 5, 6, 7].map((i) => view.getUint8(at + i)));
    result.push({ type, start: at + head, end: at + size, offset: at });
    at += size;
  }
  return result;
}

function find(list: Box[], type: string): Box {
  const box = list.find((item) => item.type === type);
  if (!box) throw new ReelError(`The offset video of a group has no ${type} box.`);
  return box;
}

function descend(view: DataView, box: Box, ...path: string[]): Box {
  return path.reduce((inner, type) => find(boxes(view, inner.start, inner.end), type), box);
}

function parseTrack(file: Uint8Array, view: DataView, trak: Box, most: number): Track {
  const tkhd = descend(view, trak, "tkhd");
  const hdlr = descend(view, trak, "mdia", "hdlr");
  const stbl = descend(view, trak, "mdia", "minf", "stbl");
  const stsd = descend(view, stbl, "stsd");
  const entry = boxes(view, stsd.start + 8, stsd.end)[0];
  if (!entry || (entry.type !== "hvc1" && entry.type !== "hev1")) {
    throw new ReelError(`The offset video of a group is coded as ${entry?.type ?? "nothing"}, not H.265.`);
  }
  // A visual sample entry has 78 bytes before its boxes; width and height are at 24.
  const hvcC = find(boxes(view, entry.start + 78, entry.end), "hvcC");
  const name = new TextDecoder().decode(file.subarray(hdlr.start + 24, hdlr.end)).replace(/\0+$/, "");
  return {
    id: view.getUint32(tkhd.start + (view.getUint8(tkhd.start) === 1 ? 20 : 12)),
    name,
    width: view.getUint16(entry.start + 24),
    height: view.getUint16(entry.start + 26),
    hvcC: file.slice(hvcC.start, hvcC.end),
    samples: tableSamples(file, view, stbl, most),
  };
}

/** Return the samples of a progressive file from its sample tables; none for a fragmented file. */
function tableSamples(file: Uint8Array, view: DataView, stbl: Box, most: number): Uint8Array[] {
  const tables = boxes(view, stbl.start, stbl.end);
  const stsz = find(tables, "stsz").start;
  const fixed = view.getUint32(stsz + 4);
  const count = view.getUint32(stsz + 8);
  if (count === 0) return [];
  checkSamples(count, most);
  const long = tables.find((box) => box.type === "co64");
  const chunks = (long ?? find(tables, "stco")).start;
  const chunkCount = view.getUint32(chunks + 4);
  const stsc = find(tables, "stsc").start;
  const runs = view.getUint32(stsc + 4);
  const samples: Uint8Array[] = [];
  let run = 0;
  for (let chunk = 1; chunk <= chunkCount && samples.length < count; chunk++) {
    while (run + 1 < runs && view.getUint32(stsc + 8 + 12 * (run + 1)) <= chunk) run++;
    let at = long
      ? view.getUint32(chunks + 8 * chunk) * 2 ** 32 + view.getUint32(chunks + 8 * chunk + 4)
      : view.getUint32(chunks + 4 + 4 * chunk);
    const inChunk = view.getUint32(stsc + 8 + 12 * run + 4);
    for (let i = 0; i < inChunk && samples.length < count; i++) {
      const size = fixed || view.getUint32(stsz + 12 + 4 * samples.length);
      samples.push(cut(file, at, size));
      at += size;
    }
  }
  return samples;
}

/** Append the samples of one movie fragment. */
function addFragment(file: Uint8Array, view: DataView, moof: Box, tracks: Track[], most: number): void {
  for (const traf of boxes(view, moof.start, moof.end).filter((box) => box.type === "traf")) {
    const inner = boxes(view, traf.start, traf.end);
    const tfhd = find(inner, "tfhd").start;
    const flags = view.getUint32(tfhd) & 0xffffff;
    const track = tracks.find((item) => item.id === view.getUint32(tfhd + 4));
    if (!track) continue;
    let at = tfhd + 8;
    const base = flags & 1 ? view.getUint32(at) * 2 ** 32 + view.getUint32(at + 4) : moof.offset;
    at += (flags & 1 ? 8 : 0) + (flags & 2 ? 4 : 0) + (flags & 8 ? 4 : 0);
    const defaultSize = flags & 16 ? view.getUint32(at) : 0;
    for (const trun of inner.filter((box) => box.type === "trun"))
      addRun(file, view, trun.start, base, defaultSize, track, most);
  }
}

function addRun(
  file: Uint8Array,
  view: DataView,
  trun: number,
  base: number,
  defaultSize: number,
  track: Track,
  most: number,
): void {
  const flags = view.getUint32(trun) & 0xffffff;
  const count = view.getUint32(trun + 4);
  checkSamples(track.samples.length + count, most);
  let at = trun + 8;
  let data = base + (flags & 1 ? view.getInt32(at) : 0);
  at += (flags & 1 ? 4 : 0) + (flags & 4 ? 4 : 0);
  for (let i = 0; i < count; i++) {
    at += flags & 0x100 ? 4 : 0;
    const size = flags & 0x200 ? view.getUint32(at) : defaultSize;
    at += (flags & 0x200 ? 4 : 0) + (flags & 0x400 ? 4 : 0) + (flags & 0x800 ? 4 : 0);
    track.samples.push(cut(file, data, size));
    data += size;
  }
}

function checkSamples(count: number, most: number): void {
  if (count > most)
    throw new ReelError(`The offset video of a group claims ${count} pictures, and has ${most} frames.`);
}

function cut(file: Uint8Array, start: number, size: number): Uint8Array {
  if (start + size > file.byteLength) throw new ReelError("The offset video of a group is cut off.");
  return file.slice(start, start + size);
}
