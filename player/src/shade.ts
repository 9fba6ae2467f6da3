/** The `shade` section: how the colour and the opacity of dynamic points change over a group's frames (docs/format.md). */
import type { Container } from "./container";
import { inSection } from "./errors";
import type { Kernels } from "./kernels";
import type { Form, Texture } from "./klt";
import { COLOR, kltOf, type Neighbourhood } from "./predictive";

/** [T, N, 4]: red, green and blue of the DC term, and the opacity. */
export type Shade = Texture<Uint8Array>;

const SHADE: Form = { turn: "colour", rest: [0, 0, 0, 0], most: 255 };

/** here: what the predictive coding knows of the points; of points in the paper's coding `inOrder`. */
export async function decodeShade(file: Container, frames: number, here: Neighbourhood): Promise<Shade | null> {
  if (!file.sections.shade || file.points === 0) return null;
  return inSection("shade", () => here.kernels.decodeTexture(kltOf(file, "shade", COLOR, frames, 4, here), SHADE) as Shade);
}

/** Of points in the paper's coding: those next to each other in the file, all of class 0. */
export function inOrder(count: number, kernels: Kernels): Neighbourhood {
  const lattice = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) lattice[3 * i] = i;
  const none = new Uint8Array(count);
  return { levels: kernels.levelsOf(lattice), classes: [none, none, none], kernels };
}
