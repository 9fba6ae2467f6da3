/** Grabs of the reel in a headset: one hand moves it, two hands also scale and turn it. A short pinch or press of the trigger is no grab. */
import { add, length, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { HeadsetSpace } from "../camera/headset-space";
import { meetsLevel, positionOf, rayOf } from "./headset-input";
import type { XrFrame, XrInput, XrSession } from "./headset-support";

/** Meters by which a pinch moves before it is a grab. */
const DEAD_ZONE = 0.03;
/** Maximum distance in meters at which a finger on a screen reaches the floor. */
const REACH = 20;

interface Hold {
  /** Position at the start and in the last frame; null until the first frame. */
  start: Vec3 | null;
  last: Vec3 | null;
  /** True if the reel follows. */
  grabs: boolean;
}

type InputEvent = Event & { inputSource?: XrInput };

/** Follows the hands of one session. */
export class HeadsetGrip {
  private readonly holds = new Map<XrInput, Hold>();

  /** selected: called for a short pinch, trigger or tap. */
  constructor(
    session: XrSession,
    private readonly room: HeadsetSpace,
    selected: () => void,
  ) {
    const begin =
      (grabs: boolean) =>
      ({ inputSource }: InputEvent): void =>
        void (inputSource && this.holds.set(inputSource, { start: null, last: null, grabs }));
    const end = ({ inputSource }: InputEvent): void => void (inputSource && this.holds.delete(inputSource));
    session.addEventListener("selectstart", begin(false));
    session.addEventListener("squeezestart", begin(true));
    for (const name of ["selectend", "squeezeend"]) session.addEventListener(name, end);
    session.addEventListener(
      "select",
      ({ inputSource }: InputEvent) => this.holds.get(inputSource!)?.grabs || selected(),
    );
  }

  /** Let the reel follow the hands. */
  update(frame: XrFrame, space: object): void {
    const moves: [from: Vec3, to: Vec3][] = [];
    for (const [input, hold] of this.holds) {
      const now = this.pointOf(frame, input, space);
      if (!now) continue;
      hold.start ??= now;
      const before = hold.last;
      hold.last = now;
      if (!hold.grabs && (this.holds.size > 1 || length(subtract(now, hold.start)) > DEAD_ZONE)) hold.grabs = true;
      else if (hold.grabs && before) moves.push([before, now]);
    }
    if (moves.length === 1) this.room.transform(1, 0, ...moves[0]);
    else if (moves.length > 1) this.moveByTwo(moves[0], moves[1]);
  }

  private moveByTwo([a, nextA]: [Vec3, Vec3], [b, nextB]: [Vec3, Vec3]): void {
    const [before, now] = [subtract(b, a), subtract(nextB, nextA)];
    if (Math.min(length(before), length(now)) < 1e-3) return;
    const turn = Math.atan2(before[2], before[0]) - Math.atan2(now[2], now[0]);
    this.room.transform(length(now) / length(before), turn, scale(add(a, b), 0.5), scale(add(nextA, nextB), 0.5));
  }

  /** Return where an input holds the reel: at the hand, or below a finger on a screen, on the floor. */
  private pointOf(frame: XrFrame, input: XrInput, space: object): Vec3 | null {
    if (input.targetRayMode === "screen") {
      const ray = rayOf(frame, input, space);
      return ray && meetsLevel(ray, this.room.floor, REACH);
    }
    const pose = frame.getPose(input.gripSpace ?? input.targetRaySpace, space);
    return pose && positionOf(pose.transform.matrix);
  }
}
