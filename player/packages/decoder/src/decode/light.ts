/** Light of a group per frame (docs/format.md). */
import { ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import type { Container } from "../reel/container";
import { linear } from "./dequantize";

const MAX_FRAMES = 10_000;
/** Maximum factor by which the light may change, and its inverse the minimum. */
const MAX_FACTOR = 1024;

/** Decode the factors [T, 3] of all colors. */
export async function decodeLight(file: Container): Promise<Float32Array> {
  if (file.frames > MAX_FRAMES) throw new ReelError(`section light would hold ${file.frames} frames`);
  const light = await linear(file, "light", file.frames, 3);
  if (!light.every((factor) => factor > 0.99 / MAX_FACTOR && factor < 1.01 * MAX_FACTOR))
    throw new ReelError("section light has factors too far from 1");
  return light;
}

/** Return the factors at a frame of the group, interpolated linearly. */
export function lightAt(light: Float32Array | null, frame: number): Vec3 {
  if (light === null) return [1, 1, 1];
  const low = Math.floor(frame);
  const high = Math.min(low + 1, light.length / 3 - 1);
  const at = (channel: number): number =>
    light[3 * low + channel] + (frame - low) * (light[3 * high + channel] - light[3 * low + channel]);
  return [at(0), at(1), at(2)];
}
