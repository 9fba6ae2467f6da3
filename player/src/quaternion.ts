/** Turns as unit quaternions wxyz, for what is stored and for what lies between two of them. */
import type { Vec3 } from "./matrix";

export type Quat = [number, number, number, number];

/** The turn that takes x, y and z to these three axes. */
export function quatOf([x, y, z]: [Vec3, Vec3, Vec3]): Quat {
  const trace = x[0] + y[1] + z[2];
  // The largest of the four first: dividing by it loses nothing.
  const q: Quat =
    trace > 0 ? [1 + trace, y[2] - z[1], z[0] - x[2], x[1] - y[0]]
    : x[0] > y[1] && x[0] > z[2] ? [y[2] - z[1], 1 + x[0] - y[1] - z[2], x[1] + y[0], z[0] + x[2]]
    : y[1] > z[2] ? [z[0] - x[2], x[1] + y[0], 1 - x[0] + y[1] - z[2], y[2] + z[1]]
    : [x[1] - y[0], z[0] + x[2], y[2] + z[1], 1 - x[0] - y[1] + z[2]];
  return normalized(q);
}

/** Where a turn takes x, y and z. */
export function axesOf([w, x, y, z]: Quat): [Vec3, Vec3, Vec3] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The turn a part of the shorter way from a to b. */
export function slerp(a: Quat, b: Quat, t: number): Quat {
  const dot = a.reduce((sum, value, i) => sum + value * b[i], 0);
  const sign = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(Math.abs(dot), 1));
  const s = Math.sin(angle);
  const [u, v] = s > 1e-4 ? [Math.sin((1 - t) * angle) / s, Math.sin(t * angle) / s] : [1 - t, t];
  return normalized(a.map((value, i) => u * value + sign * v * b[i]) as Quat);
}

export function normalized(q: Quat): Quat {
  const size = Math.hypot(...q) || 1;
  return q.map((value) => value / size) as Quat;
}
