/** Interface of what moves the camera in place of orbits, such as a walk. */
import type { Vec3 } from "@splatreel/decoder/internal";
import type { Gaze } from "./horizon";
import type { Motion } from "./motion";

/** Position and direction of the camera, and distance of the pivot in front. */
export interface Sight {
  eye: Vec3;
  gaze: Gaze;
  distance: number;
}

/** Moves the camera. */
export interface CameraDriver {
  /** Return where the camera goes within seconds; null if it stays. keys: velocities that the pressed keys request. */
  step(sight: Sight, keys: Motion, seconds: number): Sight | null;
}
