/** Decoding of one file of a reel. */
import { ReelError, messageOf } from "../base/errors";
import { parseContainer, type Container } from "../reel/container";
import { decodeAppearance } from "./appearance";
import { flags } from "./dequantize";
import type { Gaussians } from "./gaussians";
import { plain, type Kernels } from "./kernels";
import { decodeLight } from "./light";
import type { Offsets } from "./offsets";
import { decodeMotion, decodePredictive } from "./predictive";

/** What a file says of itself. */
interface Header {
  points: Gaussians;
  /** Number of the group, or of the group at which a layer was born. */
  index: number;
  firstFrame: number;
  /** Number of frames; 0 for a layer. */
  frames: number;
}

/** A layer: static points. */
export interface DecodedLayer extends Header {
  kind: "layer";
}

/** A group: dynamic points, and which static points it shows. */
export interface DecodedGroup extends Header {
  kind: "group";
  /** [S] 1 for each static point that is alive, over the layers that live at the group, in order of birth. */
  alive: Uint8Array;
  /** Motion and appearance; null if the group has no dynamic points. */
  offsets: Offsets | null;
  /** [T, 3] factors of all colors per frame; null if the light is constant. */
  light: Float32Array | null;
}

/** A decoded file of a reel. */
export type DecodedFile = DecodedLayer | DecodedGroup;

/** Points of a file, and the motion of a group. */
export type PointsAndOffsets = Pick<DecodedGroup, "points" | "offsets">;

/** Decodes a file of the paper's codec, which is loaded on demand. */
export type DecodePaper = (file: Container, kernels: Kernels) => Promise<PointsAndOffsets>;

/** Decode a layer or group file. Throws `ReelError` that names the file. */
export async function decodeFile(
  bytes: Uint8Array,
  name: string,
  decodePaper: DecodePaper,
  kernels: Kernels = plain,
): Promise<DecodedFile> {
  const file = parseContainer(bytes, name);
  try {
    const [{ points, offsets }, alive, light] = await Promise.all([
      file.sections.means?.codec === "lattice" ? decodePredicted(file, kernels) : decodePaper(file, kernels),
      file.kind === "group" && file.sections.alive ? flags(file, "alive") : new Uint8Array(),
      file.kind === "group" && file.sections.light ? decodeLight(file) : null,
    ]);
    const { index, firstFrame, frames } = file;
    return file.kind === "layer"
      ? { kind: "layer", index, firstFrame, frames, points }
      : { kind: "group", index, firstFrame, frames, points, alive, offsets, light };
  } catch (error) {
    throw new ReelError(`${name} cannot be played: ${messageOf(error)}.`, { cause: error });
  }
}

async function decodePredicted(file: Container, kernels: Kernels): Promise<PointsAndOffsets> {
  const { points, here } = await decodePredictive(file, kernels);
  if (file.kind !== "group") return { points, offsets: null };
  const motion = await decodeMotion(file, here);
  return { points, offsets: { ...motion, appearance: await decodeAppearance(file, motion.frames, here) } };
}

/** Return the buffers of a decoded file, to transfer it to another thread without a copy. */
export function buffersOf(file: DecodedFile): ArrayBuffer[] {
  const { means, quats, scales, opacities, shBase, shRest, codebook } = file.points;
  const arrays: ArrayBufferView[] = [means, quats, scales, opacities, shBase, shRest, codebook];
  if (file.kind === "group") {
    const { alive, light, offsets } = file;
    arrays.push(alive);
    if (light) arrays.push(light);
    if (offsets) arrays.push(offsets.dx, offsets.dq);
    if (offsets?.appearance) arrays.push(offsets.appearance.data);
  }
  return [...new Set(arrays.map((array) => array.buffer as ArrayBuffer))];
}
