/** Comparison of a decoded file with its entry in the manifest. */
import type { DecodedFile } from "../decode/decode-file";
import { layersAt, type ReelFile } from "../reel/reel-file";

/** Return how a file contradicts its entry, such as a file of another group; null if it does not. kind: as listed. shDegree: highest degree of the reel. */
export function contradictionOf(
  file: DecodedFile,
  entry: ReelFile,
  kind: DecodedFile["kind"],
  shDegree: number,
): string | null {
  if (file.kind !== kind) return `is a ${file.kind}; the manifest lists it as a ${kind}`;
  const found = [file.index, file.points.count, file.firstFrame, file.frames].join(", ");
  const told = [entry.group, entry.points, entry.firstFrame, entry.frames].join(", ");
  if (found !== told) return `has the group, points, first frame and frames ${found}; the manifest says ${told}`;
  if (file.points.shDegree > shDegree)
    return `has spherical harmonics of degree ${file.points.shDegree}, above the manifest's ${shDegree}`;
  if (file.kind === "layer") return null;
  const points = layersAt(entry).reduce((sum, layer) => sum + layer.points, 0);
  return file.alive.length === points
    ? null
    : `has flags of ${file.alive.length} static points; the layers that live at it hold ${points}`;
}
