/** Checks of arguments given by pages, as in HTMLMediaElement. */
import { finite } from "@splatreel/renderer";
import type { Pose } from "../camera/pose";

/** Return a world-to-camera matrix [16], row-major, if it holds a rotation. Throws `TypeError`. */
export function checkedViewmat(viewmat: ArrayLike<number>): number[] {
  const m = checkedMatrix(viewmat, 16, "viewmat");
  const rows = [m.slice(0, 3), m.slice(4, 7), m.slice(8, 11)];
  const products = rows.flatMap((a, i) =>
    rows.slice(i).map((b, j) => a.reduce((sum, value, k) => sum + value * b[k], 0) - (j === 0 ? 1 : 0)),
  );
  if (products.some((off) => Math.abs(off) > 0.01))
    throw new TypeError("viewmat must hold a rotation: its first three rows are not perpendicular and of length 1.");
  return m;
}

/** Return a pose with valid intrinsics and rotation. Throws `TypeError`. */
export function checkedPose({ K, viewmat }: Pose): Pose {
  const lens = checkedMatrix(K, 9, "K");
  if (lens[0] <= 0 || lens[4] <= 0)
    throw new TypeError(`K must have focal lengths above 0, not ${lens[0]} and ${lens[4]}.`);
  return { K: lens, viewmat: checkedViewmat(viewmat) };
}

function checkedMatrix(values: ArrayLike<number> | null | undefined, count: number, what: string): number[] {
  const list = Array.from(values ?? []);
  if (list.length !== count) throw new TypeError(`${what} must hold ${count} numbers, row by row, not ${list.length}.`);
  return list.map((value) => finite(value, `Each number of ${what}`));
}
