/** Motion of the camera. */

/** Velocities per second: rotation about the pivot (radians), translation (pivot distances), zoom (powers of e). */
export interface Motion {
  yaw: number;
  pitch: number;
  right: number;
  down: number;
  forward: number;
  zoom: number;
}

/** Rotation about the pivot while nobody moves the camera: radians per second, after seconds of rest. */
export interface Spin {
  speed: number;
  delay: number;
}

/** No motion. */
export const STILL: Motion = { yaw: 0, pitch: 0, right: 0, down: 0, forward: 0, zoom: 0 };
/** Names of the velocities. */
export const AXES = Object.keys(STILL) as (keyof Motion)[];
