/** Decoding of files of the paper's codec: Draco positions, quantized attributes, and offsets as H.265 video. */
import { ReelError, inSection } from "../base/errors";
import type { Container } from "../reel/container";
import { decodeAppearance, neighborsInOrder } from "./appearance";
import type { PointsAndOffsets } from "./decode-file";
import { tensor } from "./dequantize";
import { decodeGaussians, type DecodePoints } from "./gaussians";
import { decodeOffsets, type DecodeTrack } from "./h265-offsets";
import type { Kernels } from "./kernels";

/** Decode a file. */
export async function decodePaper(
  file: Container,
  decodePoints: DecodePoints,
  decodeTrack: DecodeTrack,
  kernels: Kernels,
): Promise<PointsAndOffsets> {
  const section = file.sections.offsets;
  if (file.kind === "group" && file.points > 0 && !section) throw new ReelError("it has no section offsets");
  if (section && section.codec !== "h265") {
    throw new ReelError(
      `its motion has the codec ${section.codec}, and this player knows h265: encode it again with --source ofs, or with the predictive codec`,
    );
  }
  const [points, offsets] = await Promise.all([
    decodeGaussians(file, decodePoints),
    section && file.points > 0
      ? inSection("offsets", () => decodeOffsets(tensor(file, "offsets"), section, file, decodeTrack))
      : null,
  ]);
  return {
    points,
    offsets: offsets && {
      ...offsets,
      appearance: file.sections.shade
        ? await decodeAppearance(file, offsets.frames, neighborsInOrder(file.points, kernels))
        : null,
    },
  };
}
