/** Rotations as unit quaternions wxyz. */
import type { Vec3 } from "@splatreel/decoder/internal";

/** A quaternion wxyz. */
export type Quat = [number, number, number, number];

/** Return the rotation that takes x, y and z to these three axes. */
export function quatOf([x, y, z]: [Vec3, Vec3, Vec3]): Quat {
  const trace = x[0] + y[1] + z[2];
  // Start from the largest component, so that the normalization is stable.
  const q: Quat =
    trace > 0
      ? [1 + trace, y[2] - z[1], z[0] - x[2], x[1] - y[0]]
      : x[0] > y[1] && x[0] > z[2]
        ? [y[2] - z[1], 1 + x[0] - y[1] - z[2], x[1] + y[0], z[0] + x[2]]
        : y[1] > z[2]
          ? [z[0] - x[2], x[1] + y[0], 1 - x[0] + y[1] - z[2], y[2] + z[1]]
          : [x[1] - y[0], z[0] + x[2], y[2] + z[1], 1 - x[0] - y[1] + z[2]];
  return normalized(q);
}

/** Return the axes to which a rotation takes x, y and z. */
export function axesOf([w, x, y, z]: Quat): [Vec3, Vec3, Vec3] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** Interpolate from a to b along the shorter arc, at t in 0..1. */
export function slerp(a: Quat, b: Quat, t: number): Quat {
  const dot = a.reduce((sum, value, i) => sum + value * b[i], 0);
  const sign = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(Math.abs(dot), 1));
  const s = Math.sin(angle);
  const [u, v] = s > 1e-4 ? [Math.sin((1 - t) * angle) / s, Math.sin(t * angle) / s] : [1 - t, t];
  return normalized(a.map((value, i) => u * value + sign * v * b[i]) as Quat);
}

/** Return a * b: first the rotation b, then a. */
export function multiply([w, x, y, z]: Quat, [s, a, b, c]: Quat): Quat {
  return [
    w * s - x * a - y * b - z * c,
    w * a + x * s + y * c - z * b,
    w * b - x * c + y * s + z * a,
    w * c + x * b - y * a + z * s,
  ];
}

/** Return the shortest rotation from a to b, as a rotation vector in the frame of a. */
export function turnBetween([w, x, y, z]: Quat, b: Quat): Vec3 {
  const q = multiply([w, -x, -y, -z], b);
  const size = Math.hypot(q[1], q[2], q[3]);
  const factor = size < 1e-9 ? 2 : (2 * Math.atan2(size, Math.abs(q[0]))) / size;
  return q.slice(1).map((part) => part * factor * (q[0] < 0 ? -1 : 1)) as Vec3;
}

/** Return the rotation of a rotation vector (axis times radians). */
export function turnAbout([x, y, z]: Vec3): Quat {
  const angle = Math.hypot(x, y, z);
  const s = angle < 1e-9 ? 0.5 : Math.sin(angle / 2) / angle;
  return [Math.cos(angle / 2), x * s, y * s, z * s];
}

/** Scale to unit length. */
export function normalized(q: Quat): Quat {
  const size = Math.hypot(...q) || 1;
  return q.map((value) => value / size) as Quat;
}
