/** The `shade` section: how the colour and the opacity of dynamic points change over a group's frames (docs/format.md). */
import type { Container } from "./container";
import { inSection } from "./errors";
import { levelsOf } from "./field";
import { COLOR, curves, SHARES, transformed, wholes, type Neighbourhood } from "./predictive";

/** Whole numbers that stand for min + value * step. */
export interface Shade {
  /** [T, N, 4]: red, green and blue of the DC term, and the opacity. */
  data: Uint8Array;
  min: number[];
  step: number[];
}

/** here: what the predictive coding knows of the points, null for points in the paper's. */
export async function decodeShade(file: Container, frames: number, here: Neighbourhood | null): Promise<Shade | null> {
  if (!file.sections.shade || file.points === 0) return null;
  const changes = await inSection("shade", () => transformed(file, "shade", COLOR, frames, 4, here ?? neighboursInOrder(file.points)));
  const changing = Uint32Array.from({ length: file.points }, (_, i) => i).filter((i) => changes.ends[i] > 0);
  const values = curves(changes, changing, 4);
  for (let i = 0; i < values.length; i += 4) {
    const bright = values[i] * SHARES[0];
    const red = values[i + 1] * SHARES[1];
    const green = values[i + 2] * SHARES[2];
    values[i] = bright + red - green;
    values[i + 1] = bright + 2 * green;
    values[i + 2] = bright - red - green;
    values[i + 3] /= 2;
  }
  const data = new Uint8Array(4 * frames * file.points);
  return { data, ...wholes(values, 4, [0, 0, 0, 0], changing, data, 255) };
}

/** Of points in the paper's coding: those next to each other in the file, all of class 0. */
function neighboursInOrder(count: number): Neighbourhood {
  const lattice = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) lattice[3 * i] = i;
  const none = new Uint8Array(count);
  return { levels: levelsOf(lattice), classes: [none, none, none] };
}
