/** Changes of a group's points over its frames: motion, color and opacity. */
import type { Texture } from "./klt";

/** [T, N, 4] changes of red, green and blue of the DC term, and of the opacity. */
export type Appearance = Texture<Uint8Array>;

/**
 * Offsets as stored integers, which the shader dequantizes: dx = dxMin + value * dxStep; dq = dqMin + value * dqStep, then normalized.
 */
export interface Offsets {
  frames: number;
  /** [T, N, 4]; the fourth channel is unused. */
  dx: Uint16Array;
  /** [T, N, 4] wxyz */
  dq: Uint8Array;
  dxMin: number[];
  dxStep: number[];
  dqMin: number[];
  dqStep: number[];
  /** True if dq rotates in world space, after the point's own rotation; false if it rotates in the point's frame. */
  worldly: boolean;
  /** Null if color and opacity are constant. */
  appearance: Appearance | null;
}
