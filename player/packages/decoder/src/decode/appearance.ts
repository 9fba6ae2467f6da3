/** The `shade` section: changes of color and opacity of dynamic points over a group's frames (docs/format.md). */
import { inSection } from "../base/errors";
import type { Container } from "../reel/container";
import type { Kernels } from "./kernels";
import type { Form } from "./klt";
import type { Appearance } from "./offsets";
import { COLOR, kltOf, type Neighborhood } from "./predictive";

const FORM: Form = { turn: "color", rest: [0, 0, 0, 0], most: 255 };

/** Decode the section. here: neighborhood of the points; `neighborsInOrder` for the paper's codec. */
export async function decodeAppearance(
  file: Container,
  frames: number,
  here: Neighborhood,
): Promise<Appearance | null> {
  if (!file.sections.shade || file.points === 0) return null;
  return inSection(
    "shade",
    () => here.kernels.decodeTexture(kltOf(file, "shade", COLOR, frames, 4, here), FORM) as Appearance,
  );
}

/** Return the neighborhood for the paper's codec: points adjacent in the file, all of class 0. */
export function neighborsInOrder(count: number, kernels: Kernels): Neighborhood {
  const quantized = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) quantized[3 * i] = i;
  const none = new Uint8Array(count);
  return { levels: kernels.levelsOf(quantized), classes: [none, none, none], kernels };
}
