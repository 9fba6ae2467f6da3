/** Views with a level horizon: the camera's right axis is always derived from where it looks and from `up`, and never carried along. */
import { add, cross, dot, length, normalize, rotate, scale, subtract, type Vec3 } from "../base/matrix";
import { axesOf, multiply, quatOf, slerp, turnBetween, type Quat } from "../base/quaternion";

/** Closest a level view comes to straight up or down, radians. */
const POLE = 0.1;
const STEEPEST = Math.PI / 2 - POLE;
const NONE: Quat = [1, 0, 0, 0];
/** Radians of tilt that nobody sees. */
const LEVEL = 1e-5;

/** Where a camera looks: a level view, and what the picture is tilted by in the camera's own axes. */
export interface Gaze {
  /** Unit vector, perpendicular to `up`. */
  heading: Vec3;
  /** Height of the view above the heading, radians. */
  pitch: number;
  /** Of a pose that somebody gave. Zero for views that hands made. */
  tilt: Quat;
}

export class Horizon {
  /** up: unit vector. */
  constructor(private readonly up: Vec3) {}

  /** Split a turn of the camera's axes (camera to world). A view of straight up or down has its heading at the top of the picture. */
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

  /** Turn of the camera's axes (camera to world). */
  turnOf(gaze: Gaze): Quat {
    const forward = this.forwardOf(gaze);
    const right = cross(gaze.heading, this.up);
    return multiply(quatOf([right, cross(forward, right), forward]), gaze.tilt);
  }

  /** What is in the middle of the picture, once it is level. Unit vector. */
  forwardOf({ heading, pitch }: Gaze): Vec3 {
    return add(scale(heading, Math.cos(pitch)), scale(this.up, Math.sin(pitch)));
  }

  /** Turn by angles in radians: positive yaw is to the left, positive pitch up. */
  turned({ heading, pitch, tilt }: Gaze, yaw: number, pitchBy: number): Gaze {
    const next = Math.min(Math.max(pitch + pitchBy, -STEEPEST), STEEPEST);
    return { heading: this.levelled(rotate(heading, this.up, yaw)), pitch: next, tilt };
  }

  /** Look in a direction. Straight above and below the heading changes little by little, since it says nothing there. */
  toward(gaze: Gaze, direction: Vec3): Gaze {
    const unit = normalize(direction);
    const flat = this.flat(unit);
    const part = Math.min(length(flat) / Math.sin(POLE), 1);
    return this.turned(gaze, part * this.yawTo(gaze.heading, flat), pitchOf(dot(unit, this.up)) - gaze.pitch);
  }

  /** The level view in the same direction. */
  level(gaze: Gaze): Gaze {
    return { ...gaze, tilt: NONE };
  }

  /** Take away a part of the tilt. */
  righted(gaze: Gaze, part: number): Gaze {
    const tilt = slerp(gaze.tilt, NONE, part);
    return { ...gaze, tilt: length(turnBetween(tilt, NONE)) > LEVEL ? tilt : NONE };
  }

  isLevel({ tilt }: Gaze): boolean {
    return tilt === NONE;
  }

  /** A part of the way from one view to another, by yaw and pitch: between level views the horizon stays level. */
  between(from: Gaze, to: Gaze, t: number): Gaze {
    const yaw = t * this.yawTo(from.heading, to.heading);
    return { heading: this.levelled(rotate(from.heading, this.up, yaw)), pitch: from.pitch + t * (to.pitch - from.pitch), tilt: slerp(from.tilt, to.tilt, t) };
  }

  /** Angle about `up` from one level direction to another, radians. */
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
