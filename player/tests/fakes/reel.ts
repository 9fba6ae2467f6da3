/** Manifests of small reels. */
import { parseManifest, type Manifest } from "../../src/reel/manifest";

export const ADDRESS = "https://page.example/reel/manifest.json";

export interface Plan {
  /** Groups of a second, ten frames each. */
  groups?: number;
  /** Groups at which layers are born. */
  layers?: number[];
  /** Names of renditions, best first: each has half of the bytes and points of the one before. */
  renditions?: string[];
  live?: boolean;
  overlap?: number;
  /** Points of a group. */
  points?: number;
}

/** The JSON of a manifest. Group I is groups/I.bin, in other renditions groups/I.NAME.bin, of 1000 bytes; layer I is layers/I.bin of 500. */
export function documentOf({ groups = 5, layers = [0], renditions = [], live = false, overlap = 2, points = 100 }: Plan = {}): Record<string, unknown> {
  const viewmat = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1];
  const file = (uri: string, bytes: number, part = 1) => ({ uri, bytes: bytes * part, sha256: null, points: points * part });
  const others = (index: number) => renditions.slice(1).map((name, i) => [name, file(`groups/${index}.${name}.bin`, 1000, 0.5 ** (i + 1))]);
  return {
    format: "splatreel",
    version: 1,
    live,
    fps: 10,
    frames: 10 * groups,
    overlap,
    sh_degree: 0,
    bounds: [[-1, -1, -1], [1, 1, 1]],
    up: [0, -1, 0],
    camera: { name: "start", width: 160, height: 90, K: [100, 0, 80, 0, 100, 45, 0, 0, 1], viewmat },
    layers: layers.map((group, index) => ({ ...file(`layers/${index}.bin`, 500), group })),
    renditions: renditions.map((name) => ({ name })),
    groups: Array.from({ length: groups }, (_, index) => ({
      ...file(`groups/${index}.bin`, 1000), first_frame: 10 * index, frames: 10, renditions: Object.fromEntries(others(index)),
    })),
  };
}

export function manifestOf(plan: Plan = {}): Manifest {
  return parseManifest(documentOf(plan), ADDRESS);
}
