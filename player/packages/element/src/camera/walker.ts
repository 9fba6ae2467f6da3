/** Walks through the scene: looks around from the eye, moves along the ground, and stays within the limits of the view. */
import { add, cross, length, type Manifest, normalize, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { CameraDriver, Sight } from "./driver";
import { Horizon } from "./horizon";
import { Limits } from "./limits";
import type { Motion } from "./motion";
import { metersPerUnit } from "./scene-size";

/** Walking speed, in meters per second. */
const SPEED = 1.4;
/** Rates at which the speed adapts, and at which a tilt decays and the limits pull, per second. */
const AGILITY = 8;
const PULL = 5;
/** Speed that is no motion any more, relative to the walking speed, and distance that is none, relative to the scene. */
const SLOW = 0.01;
const NEAR = 1e-4;

/** Moves the camera of one reel. */
export class Walker implements CameraDriver {
  /** Deflection of the stick to the right and ahead, each -1 to 1. */
  stick: [number, number] = [0, 0];
  private readonly horizon: Horizon;
  private readonly limits: Limits;
  private readonly up: Vec3;
  /** World units per second. */
  private readonly speed: number;
  /** Angles by which people turned since the last step, in radians. */
  private turned: [yaw: number, pitch: number] = [0, 0];
  private velocity: Vec3 = [0, 0, 0];
  /** True from an input until the walk is at rest within the limits. */
  private walking = false;

  /** calm: no inertia, for people who prefer reduced motion. */
  constructor(
    manifest: Manifest,
    private readonly calm: boolean,
  ) {
    this.up = normalize(manifest.up);
    this.horizon = new Horizon(this.up);
    this.limits = new Limits(manifest);
    this.speed = SPEED / metersPerUnit(manifest);
  }

  /** Turn by angles in radians: positive yaw is to the right, positive pitch down. */
  look(yaw: number, pitch: number): void {
    this.turned = [this.turned[0] + yaw, this.turned[1] + pitch];
  }

  step(sight: Sight, keys: Motion, seconds: number): Sight | null {
    const { horizon, speed, calm } = this;
    const wanted = this.wantedSpeed(sight, keys);
    const [yaw, pitch] = [this.turned[0] + keys.yaw * seconds, this.turned[1] + keys.pitch * seconds];
    this.turned = [0, 0];
    if (length(wanted) > 0 || yaw !== 0 || pitch !== 0) this.walking = true;
    if (!this.walking) return null;
    const part = (rate: number): number => (calm ? 1 : 1 - Math.exp(-rate * seconds));
    this.velocity = add(this.velocity, scale(subtract(wanted, this.velocity), part(AGILITY)));
    const gaze = horizon.righted(horizon.turned(sight.gaze, -yaw, -pitch), part(PULL));
    const free = add(sight.eye, scale(this.velocity, seconds));
    const eye = this.limits.eye(free, part(PULL));
    const rests =
      length(this.velocity) < SLOW * speed &&
      length(wanted) === 0 &&
      length(subtract(eye, free)) < NEAR * this.limits.extent;
    if (rests && horizon.isLevel(gaze)) [this.walking, this.velocity] = [false, [0, 0, 0]];
    return { eye, gaze, distance: sight.distance };
  }

  /** Return the velocity that keys and stick request. It is level, but for the keys up and down. */
  private wantedSpeed({ gaze }: Sight, keys: Motion): Vec3 {
    const { stick, up, speed } = this;
    const ahead = stick[1] + Math.sign(keys.forward);
    const right = stick[0] + Math.sign(keys.right);
    const way = add(
      add(scale(gaze.heading, ahead), scale(cross(gaze.heading, up), right)),
      scale(up, -Math.sign(keys.down)),
    );
    return scale(way, speed / Math.max(length(way), 1));
  }
}
