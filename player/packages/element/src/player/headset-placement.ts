/** Placement of a reel in the room: a ring shows the floor that the viewer looks at, and the first tap puts the reel there. */
import { add, dot, type Manifest, normalize, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { HeadsetSpace } from "../camera/headset-space";
import { positionOf } from "./headset-input";
import type { XrFrame, XrSession } from "./headset-support";
import type { Mark } from "@splatreel/renderer";

/** Minimum height of the unit normal of a surface that is level. */
const LEVEL = 0.9;
/** Distance in meters ahead of the viewer at which the reel is placed where no floor was found. */
const AHEAD = 2;

/** Places one reel. */
export class HeadsetPlacement {
  placed = false;
  private hit: Vec3 | null = null;

  private constructor(
    private readonly room: HeadsetSpace,
    private readonly anchor: Vec3,
    private readonly eye: Vec3,
    private readonly source: object,
  ) {}

  /** Begin to look for the floor. eye: position of the first view, in world units. */
  static async begin(session: XrSession, room: HeadsetSpace, manifest: Manifest, eye: Vec3): Promise<HeadsetPlacement> {
    const source = await session.requestHitTestSource({ space: await session.requestReferenceSpace("viewer") });
    return new HeadsetPlacement(room, footOf(manifest), eye, source);
  }

  /** Look for the floor. Returns the marks to draw. */
  update(frame: XrFrame, space: object): Mark[] {
    if (this.placed) return [];
    const poses = frame.getHitTestResults(this.source).flatMap((result) => result.getPose(space) ?? []);
    const level = poses.find(({ transform: { matrix } }) => matrix[5] > LEVEL);
    this.hit = level ? positionOf(level.transform.matrix) : null;
    return this.hit ? [{ center: this.hit }] : [];
  }

  /** Put the reel on the floor, with its first view toward the viewer. head: matrix [16] of the viewer's pose. */
  place(head: ArrayLike<number>): void {
    const { room, anchor, eye } = this;
    const viewer = positionOf(head);
    const ahead = normalize([-head[8], 0, -head[10]]);
    const to = this.hit ?? [viewer[0] + AHEAD * ahead[0], room.floor, viewer[2] + AHEAD * ahead[2]];
    const from = room.pointOf(anchor);
    const [front, back] = [subtract(room.pointOf(eye), from), subtract(viewer, to)];
    room.transform(1, Math.atan2(front[2], front[0]) - Math.atan2(back[2], back[0]), from, to);
    this.placed = true;
  }
}

/** Return the point of the reel that stands on the floor: below its focus. */
function footOf({ bounds: [low, high], up, presentation: { limits } }: Manifest): Vec3 {
  const y = normalize(up);
  const focus = limits?.focus ?? scale(add(low, high), 0.5);
  const corners = Array.from({ length: 8 }, (_, i): Vec3 => [
    [low, high][i & 1][0],
    [low, high][(i >> 1) & 1][1],
    [low, high][i >> 2][2],
  ]);
  const floor = limits?.floor ?? Math.min(...corners.map((corner) => dot(corner, y)));
  return add(focus, scale(y, floor - dot(focus, y)));
}
