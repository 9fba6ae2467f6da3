/**
 * Virtual and augmented reality by WebXR: two views per frame, on the headset's own clock. A pinch or trigger plays and pauses, hands
 * move the reel, thumbsticks the viewer, and in augmented reality the first tap places the reel. This part is loaded on demand.
 */
import {
  add,
  dot,
  eyeOf,
  length,
  type Manifest,
  normalize,
  ReelError,
  scale,
  subtract,
  type Vec3,
} from "@splatreel/decoder/internal";
import { type HeadsetMode, headsetSystem, type XrFrame, type XrInput, type XrSession } from "./headset-support";
import { HeadsetSpace } from "../camera/headset-space";
import { type Eye, type HeadsetLayer, HeadsetMarks, type Mark, type MarkedEye } from "@splatreel/renderer";
import { Limits } from "../camera/limits";
import type { OrbitCamera } from "../camera/orbit-camera";
import type { Player } from "./player";

/** A ray. */
export interface Ray {
  origin: Vec3;
  /** Unit vector. */
  direction: Vec3;
}

/** Return the position of a matrix [16], column-major. */
export function positionOf(matrix: ArrayLike<number>): Vec3 {
  return [matrix[12], matrix[13], matrix[14]];
}

/** Return the ray along which an input points; null while it is not tracked. */
export function rayOf(frame: XrFrame, input: XrInput, space: object): Ray | null {
  const pose = frame.getPose(input.targetRaySpace, space);
  if (!pose) return null;
  const { matrix } = pose.transform;
  return { origin: positionOf(matrix), direction: [-matrix[8], -matrix[9], -matrix[10]] };
}

/** Return where a ray meets a level plane within a distance in meters; null if it does not. */
export function meetsLevel({ origin, direction }: Ray, height: number, most: number): Vec3 | null {
  const way = (height - origin[1]) / direction[1];
  return way > 0 && way <= most ? add(origin, scale(direction, way)) : null;
}

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

/** Deflections at which the stick acts and is released. */
const PUSHED = 0.7;
const RELEASED = 0.3;
/** Maximum distance of a jump, in meters, and angle of a turn, in radians. */
const TELEPORT_REACH = 10;
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
    const floor = ray && meetsLevel(ray, room.floor, TELEPORT_REACH);
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

/** Intrinsics of a view so wide that its sort order contains all that the eyes see. */
const WIDE = { fx: 0.05, fy: 0.05, cx: 0.5, cy: 0.5 };

/** A running WebXR session of a player. */
export class Headset {
  private readonly camera: OrbitCamera;
  private readonly grip: HeadsetGrip;
  private readonly teleport: HeadsetTeleport;
  private readonly marks: HeadsetMarks;
  /** Pose of the viewer in the last frame. */
  private head: ArrayLike<number> | null = null;

  private constructor(
    private readonly player: Player,
    private readonly session: XrSession,
    private readonly layer: HeadsetLayer,
    private readonly space: object,
    private readonly room: HeadsetSpace,
    private readonly placement: HeadsetPlacement | null,
  ) {
    this.camera = player.camera!;
    this.grip = new HeadsetGrip(session, room, () => this.select());
    this.teleport = new HeadsetTeleport(room, new Limits(player.manifest!));
    this.marks = new HeadsetMarks(player.canvas.getContext("webgl2")!); // WebXR's layers are WebGL's
  }

  /** Show the reel of a player in the headset. Browsers allow this only in response to a click. ended: called when the session ends. */
  static async enter(player: Player, mode: HeadsetMode, ended: () => void): Promise<Headset> {
    const { camera, manifest, stage } = player;
    if (!camera || !manifest || !stage) throw new ReelError("There is no reel to show in the headset yet.");
    const needs = mode === "ar" ? { requiredFeatures: ["hit-test"] } : {};
    const session = await headsetSystem()!.requestSession(`immersive-${mode}`, {
      ...needs,
      optionalFeatures: ["local-floor"],
    });
    let headset: Headset | null = null;
    session.addEventListener("end", () => {
      headset?.marks.delete();
      stage.passthrough = false;
      player.playback.drawInPage();
      ended();
    });
    try {
      const layer = await stage.createHeadsetLayer(session);
      session.updateRenderState({ baseLayer: layer });
      const floor = await session.requestReferenceSpace("local-floor").catch(() => null);
      const space = floor ?? (await session.requestReferenceSpace("local"));
      const room = new HeadsetSpace(manifest, camera.viewmat, floor !== null);
      const placement =
        mode === "ar" ? await HeadsetPlacement.begin(session, room, manifest, eyeOf(camera.viewmat)) : null;
      headset = new Headset(player, session, layer, space, room, placement);
    } catch (error) {
      void session.end();
      throw error;
    }
    stage.passthrough = mode === "ar";
    player.playback.letCallerDraw();
    session.requestAnimationFrame(headset.draw);
    return headset;
  }

  /** End the session. */
  leave(): void {
    void this.session.end();
  }

  /** Place the reel, or else play or pause. */
  private select(): void {
    const { player, placement, head } = this;
    if (placement && !placement.placed) head && placement.place(head);
    else if (player.paused) player.play();
    else player.pause();
  }

  private readonly draw = (now: number, frame: XrFrame): void => {
    const { player, session, space, room, layer, camera, placement } = this;
    if (!player.presented) return;
    session.requestAnimationFrame(this.draw);
    const pose = frame.getViewerPose(space);
    if (!pose || player.camera !== camera) return; // the headset is off, or another reel was opened
    this.head = pose.transform.matrix;
    const marks = placement
      ? placement.update(frame, space)
      : this.teleport.update(frame, space, session.inputSources ?? [], positionOf(this.head));
    const waits = placement?.placed === false;
    if (!waits) this.grip.update(frame, space);
    const [eyes, marked]: [Eye[], MarkedEye[]] = [[], []];
    for (const seen of pose.views) {
      const port = layer.getViewport(seen);
      if (!port) continue;
      const {
        projectionMatrix,
        transform: {
          inverse: { matrix: inverse },
        },
      } = seen;
      const { x, y, width, height } = port;
      eyes.push({
        framebuffer: layer.framebuffer,
        x,
        y,
        view: room.view(inverse, projectionMatrix, width, height, camera.near),
      });
      marked.push({ port, projection: projectionMatrix, inverse });
    }
    if (eyes.length === 0) return;
    const view = {
      ...room.view(pose.transform.inverse.matrix, pose.views[0].projectionMatrix, 1, 1, camera.near),
      ...WIDE,
    };
    if (!waits) player.playback.drawForCaller(now, view, eyes);
    this.marks.draw(layer.framebuffer, marked, marks, waits);
  };
}
