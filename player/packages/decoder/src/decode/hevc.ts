/** Decoding of H.265 tracks to luma planes, by WebCodecs if the browser has HEVC, else by a WASM decoder. Runs in a worker. */
import { ReelError, messageOf } from "../base/errors";
import { fileAddress, type FileAddresses } from "../files/workers";
import type { Track } from "./mp4";

/** The part of the Emscripten module hevc-decode.js (npm @hevcjs/core) that is used here. */
interface HevcModule {
  HEAPU8: Uint8Array;
  HEAPU16: Uint16Array;
  _malloc(bytes: number): number;
  _free(pointer: number): void;
  _hevc_decoder_create(): number;
  _hevc_decoder_destroy(decoder: number): void;
  _hevc_decoder_feed(decoder: number, data: number, size: number): number;
  _hevc_decoder_drain(decoder: number, count: number): number;
  _hevc_decoder_get_drained_frame(decoder: number, index: number, frame: number): number;
  _hevc_decoder_flush(decoder: number): number;
}

/** Exports of hevc-decode.js. */
interface HevcExport {
  default(options: object): Promise<HevcModule>;
}

/** Contents of an hvcC box. */
export interface HevcHeader {
  /** Codec string of RFC 6381, such as hvc1.1.6.L93.90. */
  codec: string;
  /** Bytes of the length field of a NAL unit. */
  lengthSize: number;
  parameterSets: Uint8Array[];
}

/** Decode the luma planes [samples, height, width] of a track, in display order. */
export async function decodeTrack(track: Track, files: FileAddresses): Promise<Uint8Array> {
  const header = parseHvcC(track.hvcC);
  if (await hasWebCodecs(track, header)) {
    try {
      return await decodeWithWebCodecs(track, header);
    } catch {
      // Some platforms announce HEVC and then reject a stream, or return frames that cannot be read back. The WASM
      // decoder gives the same bytes.
    }
  }
  return decodeWithWasm(track, header, files);
}

/** Read a HEVCDecoderConfigurationRecord (ISO/IEC 14496-15, 8.3.3.1). */
export function parseHvcC(hvcC: Uint8Array): HevcHeader {
  const view = new DataView(hvcC.buffer, hvcC.byteOffset, hvcC.byteLength);
  const profile = hvcC[1] & 31;
  const tier = hvcC[1] & 32 ? "H" : "L";
  const compatibility = reverseBits(view.getUint32(2)).toString(16);
  const constraints = [...hvcC.subarray(6, 12)];
  while (constraints.length > 1 && constraints.at(-1) === 0) constraints.pop();
  const tail = constraints.map((byte) => `.${byte.toString(16).toUpperCase()}`).join("");
  const codec = `hvc1.${profile}.${compatibility}.${tier}${hvcC[12]}${tail}`;
  const parameterSets: Uint8Array[] = [];
  let at = 23;
  for (let array = 0; array < hvcC[22]; array++) {
    const count = view.getUint16(at + 1);
    at += 3;
    for (let i = 0; i < count; i++) {
      const size = view.getUint16(at);
      parameterSets.push(hvcC.subarray(at + 2, at + 2 + size));
      at += 2 + size;
    }
  }
  return { codec, lengthSize: (hvcC[21] & 3) + 1, parameterSets };
}

function reverseBits(value: number): number {
  let result = 0;
  for (let i = 0; i < 32; i++) result = (result << 1) | ((value >>> i) & 1);
  return result >>> 0;
}

async function hasWebCodecs(track: Track, header: HevcHeader): Promise<boolean> {
  if (typeof VideoDecoder === "undefined") return false;
  return (await VideoDecoder.isConfigSupported(configOf(track, header))).supported === true;
}

function configOf(track: Track, header: HevcHeader): VideoDecoderConfig {
  return { codec: header.codec, codedWidth: track.width, codedHeight: track.height, description: track.hvcC };
}

async function decodeWithWebCodecs(track: Track, header: HevcHeader): Promise<Uint8Array> {
  const planeBytes = track.width * track.height;
  const planes = new Uint8Array(planeBytes * track.samples.length);
  const copies: Promise<void>[] = [];
  let failure: unknown;
  const decoder = new VideoDecoder({
    output: (frame) => copies.push(copyLuma(frame, track, planes).finally(() => frame.close())),
    error: (error) => (failure = error),
  });
  try {
    decoder.configure(configOf(track, header));
    track.samples.forEach((data, index) => {
      decoder.decode(new EncodedVideoChunk({ type: index === 0 ? "key" : "delta", timestamp: index, data }));
    });
    await decoder.flush();
    await Promise.all(copies);
  } finally {
    if (decoder.state !== "closed") decoder.close();
  }
  if (failure) throw failure;
  if (copies.length !== track.samples.length) throw new ReelError("The browser's H.265 decoder lost frames.");
  return planes;
}

/** Copy the luma plane, the first one of I420 and NV12. Drawing the frame instead would convert its colors. */
async function copyLuma(frame: VideoFrame, track: Track, planes: Uint8Array): Promise<void> {
  if (frame.format !== "I420" && frame.format !== "NV12")
    throw new ReelError(`Frames of format ${frame.format} are opaque.`);
  const rect = frame.visibleRect;
  if (!rect || rect.width !== track.width || rect.height !== track.height)
    throw new ReelError("Unexpected frame size.");
  const buffer = new Uint8Array(frame.allocationSize({ rect }));
  const [{ offset, stride }] = await frame.copyTo(buffer, { rect });
  const start = frame.timestamp * track.width * track.height;
  for (let y = 0; y < track.height; y++) {
    const from = offset + y * stride;
    planes.set(buffer.subarray(from, from + track.width), start + y * track.width);
  }
}

let wasm: Promise<HevcModule> | undefined;

function loadWasm(files: FileAddresses): Promise<HevcModule> {
  wasm ??= (import(fileAddress(files, "hevc-decode.js")) as Promise<HevcExport>).then((module) =>
    module.default({ locateFile: (name: string) => fileAddress(files, name) }),
  );
  return wasm;
}

async function decodeWithWasm(track: Track, header: HevcHeader, files: FileAddresses): Promise<Uint8Array> {
  const module = await loadWasm(files);
  const planes = new Uint8Array(track.width * track.height * track.samples.length);
  const decoder = module._hevc_decoder_create();
  const scratch = module._malloc(64);
  let done = 0;
  const drain = (limit: number): void => {
    for (let i = 0; i < limit; i++) {
      if (module._hevc_decoder_get_drained_frame(decoder, i, scratch) !== 0) return;
      if (done < track.samples.length) copyWasmLuma(module, scratch, track, planes, done);
      done++;
    }
  };
  try {
    feed(module, decoder, annexB(header.parameterSets));
    for (const sample of track.samples) {
      feed(module, decoder, annexB(units(sample, header.lengthSize)));
      if (module._hevc_decoder_drain(decoder, scratch) === 0) drain(integers(module, scratch, 1)[0]);
    }
    if (module._hevc_decoder_flush(decoder) === 0) drain(Infinity);
  } catch (error) {
    throw new ReelError(`The offset video of a group cannot be decoded (${messageOf(error)}).`);
  } finally {
    module._free(scratch);
    module._hevc_decoder_destroy(decoder);
  }
  if (done !== track.samples.length)
    throw new ReelError(`The offset video of a group has ${done} frames of ${track.samples.length}.`);
  return planes;
}

function feed(module: HevcModule, decoder: number, data: Uint8Array): void {
  const pointer = module._malloc(data.length);
  try {
    module.HEAPU8.set(data, pointer);
    const code = module._hevc_decoder_feed(decoder, pointer, data.length);
    if (code !== 0) throw new ReelError(`code ${code}`);
  } finally {
    module._free(pointer);
  }
}

/** Copy the luma plane of a frame struct: pointers y, cb, cr, then width, height, and luma stride in 16-bit samples. */
function copyWasmLuma(module: HevcModule, struct: number, track: Track, planes: Uint8Array, frame: number): void {
  const [luma, , , width, height, stride] = integers(module, struct, 6);
  if (width !== track.width || height !== track.height) throw new ReelError(`a frame is ${width}x${height}`);
  let out = frame * width * height;
  for (let y = 0; y < height; y++) {
    const row = (luma >> 1) + y * stride;
    for (let x = 0; x < width; x++) planes[out++] = module.HEAPU16[row + x];
  }
}

/** Return 32-bit integers in the memory of the module. Call it each time, since the memory may be reallocated. */
function integers(module: HevcModule, pointer: number, count: number): Int32Array {
  return new Int32Array(module.HEAPU8.buffer, pointer, count);
}

function* units(sample: Uint8Array, lengthSize: number): Generator<Uint8Array> {
  for (let at = 0; at + lengthSize <= sample.length;) {
    let size = 0;
    for (let i = 0; i < lengthSize; i++) size = size * 256 + sample[at++];
    yield sample.subarray(at, at + size);
    at += size;
  }
}

function annexB(nals: Iterable<Uint8Array>): Uint8Array {
  const list = [...nals];
  const result = new Uint8Array(list.reduce((sum, nal) => sum + nal.length + 4, 0));
  let at = 0;
  for (const nal of list) {
    result.set([0, 0, 0, 1], at);
    result.set(nal, at + 4);
    at += nal.length + 4;
  }
  return result;
}
