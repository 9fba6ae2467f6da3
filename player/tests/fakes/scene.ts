/** Scene of camera tests: a camera four units from the middle, y down as in the golden reels, looking along z. */
import assert from "node:assert/strict";
import type { Camera, Manifest } from "../../packages/decoder/src/reel/manifest";

export const CAMERA: Camera = {
  name: "start",
  width: 160,
  height: 120,
  K: [120, 0, 80, 0, 120, 60, 0, 0, 1],
  viewmat: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1],
};

/** Manifest of a scene from -1 to 1 with these cameras. */
export const manifestOf = (limits: object | null = null, cameras: Camera[] = [CAMERA], up = [0, -1, 0]): Manifest =>
  ({
    camera: cameras[0],
    cameras,
    near: 0.1,
    up,
    bounds: [
      [-1, -1, -1],
      [1, 1, 1],
    ],
    presentation: { limits },
  }) as unknown as Manifest;

export const MANIFEST = manifestOf();

/** Check that numbers are alike. */
export const close = (a: readonly number[], b: readonly number[], most = 1e-6): void =>
  a.forEach((value, i) => assert.ok(Math.abs(value - b[i]) < most, `${a} is not ${b}`));
