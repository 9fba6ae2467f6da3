/** What changes of a group's points over its frames: motion, color and opacity. */
import type { Texture } from "./klt";

/** [T, N, 4]: red, green and blue of the DC term, and the opacity. */
export type Appearance = Texture<Uint8Array>;

/**
 * Offsets as the integers they were stored as, one texel a point: the vertex stage undoes the quantization.
 * dx = dxMin + value * dxStep; dq = dqMin + value * dqStep, to be normalized.
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
  /** Whether dq turns about the world's axes, after the points' own rotations; else about those that these have made of them. */
  worldly: boolean;
  /** Null where color and opacity stay. */
  appearance: Appearance | null;
}
