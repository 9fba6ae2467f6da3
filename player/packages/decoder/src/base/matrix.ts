/** Vector operations for cameras. */

/** A point or vector in 3D. */
export type Vec3 = [number, number, number];

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: Vec3): number => Math.sqrt(dot(a, a));

/** Return the cross product. */
export function cross(a: Vec3, b: Vec3): Vec3 {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** Return the unit vector in the same direction; z for a vector of length 0. */
export function normalize(a: Vec3): Vec3 {
  const size = length(a);
  return size > 1e-12 ? scale(a, 1 / size) : [0, 0, 1];
}

/** Rotate v by an angle (radians, right-handed) about a unit axis. */
export function rotate(v: Vec3, axis: Vec3, angle: number): Vec3 {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const along = dot(axis, v) * (1 - c);
  return add(add(scale(v, c), scale(cross(axis, v), s)), scale(axis, along));
}

/** Return the world-to-camera matrix [16], row-major, of a camera at `eye` with these axes (x right, y down, z forward). */
export function viewmatOf(eye: Vec3, right: Vec3, down: Vec3, forward: Vec3): number[] {
  const row = (axis: Vec3): number[] => [...axis, -dot(axis, eye)];
  return [...row(right), ...row(down), ...row(forward), 0, 0, 0, 1];
}

/** Return the optical center of a world-to-camera matrix [16]. */
export function eyeOf(m: number[]): Vec3 {
  const at = (i: number): number => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]);
  return [at(0), at(1), at(2)];
}
