/** One file of a reel, decoded. */
import { ReelError, inSection, messageOf } from "../base/errors";
import { parseContainer, type Container } from "../reel/container";
import { decodeAppearance, neighboursInOrder } from "./appearance";
import { flags, tensor } from "./dequantize";
import { decodeGaussians, type DecodePoints, type Gaussians } from "./gaussians";
import { decodeOffsets, type DecodeTrack } from "./h265-offsets";
import { plain, type Kernels } from "./kernels";
import { decodeLight } from "./light";
import type { Offsets } from "./offsets";
import { decodeMotion, decodePredictive } from "./predictive";

export interface DecodedFile {
  points: Gaussians;
  /** Groups: [S] which static points of the layers born so far are alive. */
  alive: Uint8Array;
  /** Groups with dynamic points. */
  offsets: Offsets | null;
  /** Groups whose light changes: [T, 3] factors of all colors. */
  light: Float32Array | null;
}

/** Decode a layer or group file. Errors name the file. */
export async function decodeFile(bytes: Uint8Array, name: string, decodePoints: DecodePoints, decodeTrack: DecodeTrack, kernels: Kernels = plain): Promise<DecodedFile> {
  const file = parseContainer(bytes, name);
  try {
    const [{ points, offsets }, alive, light] = await Promise.all([
      file.sections.means?.codec === "lattice" ? decodePredicted(file, kernels) : decodePaper(file, decodePoints, decodeTrack, kernels),
      file.sections.alive ? flags(file, "alive") : new Uint8Array(),
      file.kind === "group" && file.sections.light ? decodeLight(file) : null,
    ]);
    return { points, alive, offsets, light };
  } catch (error) {
    throw new ReelError(`${name} cannot be played: ${messageOf(error)}.`, { cause: error });
  }
}

type Moving = Pick<DecodedFile, "points" | "offsets">;

async function decodePredicted(file: Container, kernels: Kernels): Promise<Moving> {
  const { points, here } = await decodePredictive(file, kernels);
  if (file.kind !== "group") return { points, offsets: null };
  const motion = await decodeMotion(file, here);
  return { points, offsets: { ...motion, appearance: await decodeAppearance(file, motion.frames, here) } };
}

async function decodePaper(file: Container, decodePoints: DecodePoints, decodeTrack: DecodeTrack, kernels: Kernels): Promise<Moving> {
  const section = file.sections.offsets;
  if (file.kind === "group" && file.points > 0 && !section) throw new ReelError("it has no section offsets");
  if (section && section.codec !== "h265") {
    throw new ReelError(`its motion has the codec ${section.codec}, and this player knows h265: encode it again with --source ofs, or by the predictive codec`);
  }
  const [points, offsets] = await Promise.all([
    decodeGaussians(file, decodePoints),
    section && file.points > 0 ? inSection("offsets", () => decodeOffsets(tensor(file, "offsets"), section, file, decodeTrack)) : null,
  ]);
  return { points, offsets: offsets && { ...offsets, appearance: file.sections.shade ? await decodeAppearance(file, offsets.frames, neighboursInOrder(file.points, kernels)) : null } };
}

/** The buffers of a decoded file, to be handed to another thread without copying. */
export function buffersOf(file: DecodedFile): ArrayBuffer[] {
  const arrays: ArrayBufferView[] = [file.alive, ...(file.light ? [file.light] : [])];
  const collect = (value: object): void => {
    for (const item of Object.values(value)) if (ArrayBuffer.isView(item)) arrays.push(item);
  };
  collect(file.points);
  if (file.offsets) collect(file.offsets);
  if (file.offsets?.appearance) collect(file.offsets.appearance);
  return [...new Set(arrays.map((array) => array.buffer as ArrayBuffer))];
}
