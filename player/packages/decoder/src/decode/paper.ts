/** Decoding of files of the paper's codec: Draco positions, quantized attributes, and offsets as H.265 video. */
import { inSection, ReelError } from "../base/errors";
import type { Container, Section } from "../reel/container";
import { flagOf, numbersOf, tensor, whole } from "./dequantize";
import { parseMp4, type Track } from "./mp4";
import type { Offsets } from "./offsets";
import { decodeAppearance, neighborsInOrder } from "./appearance";
import type { PointsAndOffsets } from "./decode-file";
import { decodeGaussians, type DecodePoints } from "./gaussians";
import type { Kernels } from "./kernels";

/** Decodes the luma planes of a video track. */
type DecodeTrack = (track: Track) => Promise<Uint8Array>;

const BLOCK = 16;

/** Maximum number of pixels of a map beyond twice its points. */
const MAX_SLACK = 4096;
/** Maximum of frames times points. */
const MAX_VALUES = 2 ** 26;

/** Decode the offsets of a group. */
async function decodeOffsets(
  bytes: Uint8Array,
  section: Section,
  file: Container,
  decodeTrack: DecodeTrack,
): Promise<Omit<Offsets, "appearance">> {
  const { points: count, frames } = file;
  const width = whole(section, "width", BLOCK, 8192);
  const height = whole(section, "height", BLOCK, 8192);
  const fits =
    width % BLOCK === 0 && height % BLOCK === 0 && count <= width * height && width * height <= 2 * count + MAX_SLACK;
  if (!fits || frames * count > MAX_VALUES)
    throw new ReelError(`its maps of ${width} x ${height} pixels do not fit ${frames} frames of ${count} points`);
  const dx = rangeOf(section, "dx", 3, 65535);
  const dq = rangeOf(section, "dq", 4, 255);
  const tracks = parseMp4(bytes, frames);
  [3, 3, 4].forEach((channels, i) => {
    if (tracks[i]?.width !== channels * width || tracks[i].height !== height)
      throw new ReelError("its offset maps have the wrong size");
  });
  if (!tracks.every((track) => track.samples.length === frames))
    throw new ReelError(`its offset tracks do not have ${frames} frames each`);
  const [high, low, rotation] = await Promise.all(tracks.slice(0, 3).map(decodeTrack));
  const pixels = pixelsOf(count, width);
  return {
    frames,
    dx: joinBytes(high, low, pixels, width, height, frames, flagOf(section, "fold")),
    dq: gather(rotation, pixels, width, height, frames),
    dxMin: dx.min,
    dxStep: dx.step,
    dqMin: dq.min,
    dqStep: dq.step,
    worldly: false,
  };
}

function rangeOf(section: Section, name: string, channels: number, steps: number): { min: number[]; step: number[] } {
  const min = numbersOf(section, `${name}_min`, channels);
  return { min, step: numbersOf(section, `${name}_max`, channels).map((max, i) => (max - min[i]) / steps) };
}

/** Return the pixel of each point in a map: Z-order within blocks of 16 x 16, blocks in alternating direction. */
export function pixelsOf(count: number, width: number): Uint32Array {
  const evenBits = (v: number): number => (v & 1) | ((v >> 1) & 2) | ((v >> 2) & 4) | ((v >> 3) & 8);
  const columns = width / BLOCK;
  return Uint32Array.from({ length: count }, (_, index) => {
    const block = index >> 8;
    const row = Math.floor(block / columns);
    const column = row & 1 ? columns - 1 - (block % columns) : block % columns;
    return (row * BLOCK + evenBits((index & 255) >> 1)) * width + column * BLOCK + evenBits(index & 255);
  });
}

/** Join images [T, height, 3 * width] of the high and low bytes into dx [T, N, 4]. */
function joinBytes(
  high: Uint8Array,
  low: Uint8Array,
  pixels: Uint32Array,
  width: number,
  height: number,
  frames: number,
  fold: boolean,
): Uint16Array {
  const count = pixels.length;
  const result = new Uint16Array(frames * count * 4);
  for (let i = 0; i < count; i++) {
    const y = Math.floor(pixels[i] / width);
    const inPicture = pixels[i] + y * 2 * width;
    for (let t = 0; t < frames; t++) {
      const from = t * 3 * width * height + inPicture;
      const to = 4 * (t * count + i);
      for (let c = 0; c < 3; c++) {
        const h = high[from + c * width];
        const l = low[from + c * width];
        result[to + c] = (h << 8) | (fold && h & 1 ? 255 - l : l);
      }
    }
  }
  return result;
}

/** Gather bytes [T, N, 4] from images [T, height, 4 * width]. */
function gather(picture: Uint8Array, pixels: Uint32Array, width: number, height: number, frames: number): Uint8Array {
  const count = pixels.length;
  const result = new Uint8Array(frames * count * 4);
  for (let i = 0; i < count; i++) {
    const y = Math.floor(pixels[i] / width);
    const inPicture = pixels[i] + y * 3 * width;
    for (let t = 0; t < frames; t++) {
      const from = t * 4 * width * height + inPicture;
      const to = 4 * (t * count + i);
      for (let c = 0; c < 4; c++) result[to + c] = picture[from + c * width];
    }
  }
  return result;
}

/** Decode a file. */
export async function decodePaper(
  file: Container,
  decodePoints: DecodePoints,
  decodeTrack: DecodeTrack,
  kernels: Kernels,
): Promise<PointsAndOffsets> {
  const section = file.sections.offsets;
  if (file.kind === "group" && file.points > 0 && !section) throw new ReelError("it has no section offsets");
  if (section && section.codec !== "h265") {
    throw new ReelError(
      `its motion has the codec ${section.codec}, and this player knows h265: encode it again with --source ofs, or with the predictive codec`,
    );
  }
  const [points, offsets] = await Promise.all([
    decodeGaussians(file, decodePoints),
    section && file.points > 0
      ? inSection("offsets", () => decodeOffsets(tensor(file, "offsets"), section, file, decodeTrack))
      : null,
  ]);
  return {
    points,
    offsets: offsets && {
      ...offsets,
      appearance: file.sections.shade
        ? await decodeAppearance(file, offsets.frames, neighborsInOrder(file.points, kernels))
        : null,
    },
  };
}
