/** Movement in virtual reality by the thumbstick: ahead aims at the floor and teleports there on release, to a side turns. */
import { add, length, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { HeadsetSpace } from "../camera/headset-space";
import type { Limits } from "../camera/limits";
import { meetsLevel, rayOf } from "./headset-input";
import type { XrFrame, XrInput } from "./headset-support";
import type { Mark } from "@splatreel/renderer";

/** Deflections at which the stick acts and is released. */
const PUSHED = 0.7;
const RELEASED = 0.3;
/** Maximum distance of a jump, in meters, and angle of a turn, in radians. */
const REACH = 10;
const TURN = Math.PI / 6;
/** A target is allowed if the limits would move the eyes by at most this part of the scene. */
const BEYOND = 0.01;

/** Moves the viewer of one session. */
export class HeadsetTeleport {
  private aiming: XrInput | null = null;
  private target: Vec3 | null = null;
  /** Inputs whose stick has turned the viewer and is not released yet. */
  private readonly turned = new Set<XrInput>();

  constructor(
    private readonly room: HeadsetSpace,
    private readonly limits: Limits,
  ) {}

  /** Read the sticks. head: position of the eyes. Returns the marks to draw. */
  update(frame: XrFrame, space: object, inputs: Iterable<XrInput>, head: Vec3): Mark[] {
    const marks: Mark[] = [];
    for (const input of inputs) {
      const [, , x = 0, y = 0] = input.gamepad?.axes ?? [];
      this.turn(input, x, head);
      if (this.aiming === null && y < -PUSHED) this.aiming = input;
      if (this.aiming !== input) continue;
      if (Math.abs(y) < RELEASED) this.jump(head);
      else marks.push(...this.aim(frame, space, input, head));
    }
    return marks;
  }

  private turn(input: XrInput, x: number, head: Vec3): void {
    if (Math.abs(x) < RELEASED) this.turned.delete(input);
    else if (Math.abs(x) > PUSHED && this.aiming === null && !this.turned.has(input)) {
      this.turned.add(input);
      this.room.transform(1, Math.sign(x) * TURN, head, head);
    }
  }

  private aim(frame: XrFrame, space: object, input: XrInput, head: Vec3): Mark[] {
    const { room, limits } = this;
    const ray = rayOf(frame, input, space);
    const floor = ray && meetsLevel(ray, room.floor, REACH);
    const eye = floor && room.worldOf(add(floor, [0, head[1] - room.floor, 0]));
    this.target = eye && length(subtract(limits.eye(eye), eye)) <= BEYOND * limits.extent ? floor : null;
    if (!floor) return [];
    const line: Mark = { from: ray.origin, to: floor };
    return this.target ? [line, { center: floor }] : [line];
  }

  private jump(head: Vec3): void {
    if (this.target) this.room.transform(1, 0, this.target, [head[0], this.room.floor, head[2]]);
    [this.aiming, this.target] = [null, null];
  }
}
