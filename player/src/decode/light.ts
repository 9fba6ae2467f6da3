/** The light of a whole group, frame by frame (docs/format.md). */
import { ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import type { Container } from "../reel/container";
import { linear } from "./dequantize";

const MOST_FRAMES = 10_000;
/** Factor by which light may be brighter or darker. */
const MOST = 1024;

/** [T, 3] factors of all colors. */
export async function decodeLight(file: Container): Promise<Float32Array> {
  if (file.frames > MOST_FRAMES) throw new ReelError(`section light would hold ${file.frames} frames`);
  const light = await linear(file, "light", file.frames, 3);
  if (!light.every((factor) => factor > 0.99 / MOST && factor < 1.01 * MOST)) throw new ReelError("section light has factors too far from 1");
  return light;
}

/** At a frame of the group, linear between frames. */
export function lightAt(light: Float32Array | null, frame: number): Vec3 {
  if (light === null) return [1, 1, 1];
  const low = Math.floor(frame);
  const high = Math.min(low + 1, light.length / 3 - 1);
  const at = (channel: number): number => light[3 * low + channel] + (frame - low) * (light[3 * high + channel] - light[3 * low + channel]);
  return [at(0), at(1), at(2)];
}
