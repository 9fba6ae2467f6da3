/** Views with a level horizon. The right axis is always computed from the view direction and `up`, so that no roll accumulates. */
import { add, cross, dot, length, normalize, rotate, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import { axesOf, multiply, quatOf, slerp, turnBetween, type Quat } from "../base/quaternion";

/** Minimum angle between a level view and straight up or down, in radians. */
const POLE = 0.1;
const STEEPEST = Math.PI / 2 - POLE;
const NONE: Quat = [1, 0, 0, 0];
/** Invisible tilt, in radians. */
const LEVEL = 1e-5;

/** Direction of a camera: a level view, and a tilt in the camera's frame. */
export interface Gaze {
  /** Unit vector, perpendicular to `up`. */
  heading: Vec3;
  /** Angle above the heading, in radians. */
  pitch: number;
  /** Tilt of a given pose; none for interactive views. */
  tilt: Quat;
}

/** Conversions between rotations and gazes. */
export class Horizon {
  /** up: unit vector. */
  constructor(private readonly up: Vec3) {}

  /** Convert a rotation (camera to world) to a gaze. The heading of a view straight up or down is the top of the image. */
  gazeOf(turn: Quat): Gaze {
    const [, down, forward] = axesOf(turn);
    const height = dot(forward, this.up);
    const flat = this.flat(forward);
    const steep = length(flat) < Math.sin(POLE);
    const heading = normalize(steep ? this.flat(scale(down, Math.sign(height))) : flat);
    const level: Gaze = { heading, pitch: pitchOf(height), tilt: NONE };
    const [w, x, y, z] = this.turnOf(level);
    return { ...level, tilt: multiply([w, -x, -y, -z], turn) };
  }

  /** Convert a gaze to a rotation (camera to world). */
  turnOf(gaze: Gaze): Quat {
    const forward = this.forwardOf(gaze);
    const right = cross(gaze.heading, this.up);
    return multiply(quatOf([right, cross(forward, right), forward]), gaze.tilt);
  }

  /** Return the view direction of the level view, a unit vector. */
  forwardOf({ heading, pitch }: Gaze): Vec3 {
    return add(scale(heading, Math.cos(pitch)), scale(this.up, Math.sin(pitch)));
  }

  /** Rotate by angles in radians: positive yaw is to the left, positive pitch up. */
  turned({ heading, pitch, tilt }: Gaze, yaw: number, pitchBy: number): Gaze {
    const next = Math.min(Math.max(pitch + pitchBy, -STEEPEST), STEEPEST);
    return { heading: this.levelled(rotate(heading, this.up, yaw)), pitch: next, tilt };
  }

  /** Look in a direction. Near straight up and down the heading changes gradually, since it is undefined there. */
  toward(gaze: Gaze, direction: Vec3): Gaze {
    const unit = normalize(direction);
    const flat = this.flat(unit);
    const part = Math.min(length(flat) / Math.sin(POLE), 1);
    return this.turned(gaze, part * this.yawTo(gaze.heading, flat), pitchOf(dot(unit, this.up)) - gaze.pitch);
  }

  /** Return the level view in the same direction. */
  level(gaze: Gaze): Gaze {
    return { ...gaze, tilt: NONE };
  }

  /** Reduce the tilt by a part, 0 to 1. */
  righted(gaze: Gaze, part: number): Gaze {
    const tilt = slerp(gaze.tilt, NONE, part);
    return { ...gaze, tilt: length(turnBetween(tilt, NONE)) > LEVEL ? tilt : NONE };
  }

  /** Return true if a gaze has no tilt. */
  isLevel({ tilt }: Gaze): boolean {
    return tilt === NONE;
  }

  /** Interpolate between gazes by yaw and pitch, so that the horizon stays level. */
  between(from: Gaze, to: Gaze, t: number): Gaze {
    const yaw = t * this.yawTo(from.heading, to.heading);
    return {
      heading: this.levelled(rotate(from.heading, this.up, yaw)),
      pitch: from.pitch + t * (to.pitch - from.pitch),
      tilt: slerp(from.tilt, to.tilt, t),
    };
  }

  /** Return the angle about `up` between level directions, in radians. */
  private yawTo(from: Vec3, to: Vec3): number {
    return Math.atan2(dot(cross(from, to), this.up), dot(from, to));
  }

  private flat(v: Vec3): Vec3 {
    return subtract(v, scale(this.up, dot(v, this.up)));
  }

  private levelled(heading: Vec3): Vec3 {
    return normalize(this.flat(heading));
  }
}

function pitchOf(height: number): number {
  return Math.min(Math.max(Math.asin(Math.min(Math.max(height, -1), 1)), -STEEPEST), STEEPEST);
}
