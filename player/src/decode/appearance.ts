/** The `shade` section: how the color and the opacity of dynamic points change over a group's frames (docs/format.md). */
import { inSection } from "../base/errors";
import type { Container } from "../reel/container";
import type { Kernels } from "./kernels";
import type { Form } from "./klt";
import type { Appearance } from "./offsets";
import { COLOR, kltOf, type Neighbourhood } from "./predictive";

const FORM: Form = { turn: "color", rest: [0, 0, 0, 0], most: 255 };

/** here: what the predictive coding knows of the points; of points in the paper's coding `neighboursInOrder`. */
export async function decodeAppearance(file: Container, frames: number, here: Neighbourhood): Promise<Appearance | null> {
  if (!file.sections.shade || file.points === 0) return null;
  return inSection("shade", () => here.kernels.decodeTexture(kltOf(file, "shade", COLOR, frames, 4, here), FORM) as Appearance);
}

/** Of points in the paper's coding: those next to each other in the file, all of class 0. */
export function neighboursInOrder(count: number, kernels: Kernels): Neighbourhood {
  const quantized = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) quantized[3 * i] = i;
  const none = new Uint8Array(count);
  return { levels: kernels.levelsOf(quantized), classes: [none, none, none], kernels };
}
