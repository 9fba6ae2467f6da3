/** Interactive camera that orbits a pivot, with inertia and soft limits. It starts exactly at a camera of the reel. */
import {
  add,
  type Camera,
  dot,
  eyeOf,
  length,
  type Manifest,
  normalize,
  scale,
  subtract,
  type Vec3,
  viewmatOf,
} from "@splatreel/decoder/internal";
import type { CameraDriver, Sight } from "./driver";
import { type Gaze, Horizon } from "./horizon";
import type { View } from "@splatreel/renderer";
import { axesOf } from "../base/quaternion";
import { CameraPath } from "./camera-path";
import { Limits } from "./limits";
import { AXES, type Motion, type Spin, STILL } from "./motion";
import type { OrbitBounds } from "./orbit-declaration";
import { type CameraState, turnOf, viewmatOfState } from "./pose";

/** Duration of a transition, in seconds. */
const DURATION = 0.5;

/** Moves smoothly from one pose to another. */
class Glide {
  private at: number;

  /** instant: arrive with the first step. */
  constructor(
    private readonly horizon: Horizon,
    private readonly from: Sight,
    readonly to: Sight,
    instant: boolean,
  ) {
    this.at = instant ? 1 : 0;
  }

  /** True once the last step has arrived. */
  get over(): boolean {
    return this.at === 1;
  }

  /** Return the pose after more seconds. */
  step(seconds: number): Sight {
    const { from, to, horizon } = this;
    this.at = Math.min(this.at + seconds / DURATION, 1);
    const t = this.at * this.at * (3 - 2 * this.at);
    return {
      eye: add(scale(from.eye, 1 - t), scale(to.eye, t)),
      gaze: t < 1 ? horizon.between(from.gaze, to.gaze, t) : to.gaze,
      distance: from.distance * (1 - t) + to.distance * t,
    };
  }
}

/** Maximum crop of the image to fill a wider screen, and a narrower one, where no camera shows what is above and below the image. */
const CROP = 1.4;
const NARROW_CROP = 4;
/** On a screen that crops more than `CROP`, the offset of the focus, in half widths, above which the first view is centered on it. */
const ASIDE = 0.2;

/** Fields of view for pictures of any size. */
class Framing {
  /** home: the reel's own camera. near: near plane, in world units. */
  constructor(
    private readonly home: Camera,
    private readonly near: number,
  ) {}

  /** Return the view from a pose [16] for width x height pixels. fieldOfView: vertical, in radians; null for that of the reel. */
  view(viewmat: number[], width: number, height: number, fieldOfView: number | null = null): View {
    const { K, width: w, height: h } = this.home;
    const whole = Math.min(width / w, height / h);
    const filled = Math.max(width / w, height / h);
    const fill = Math.min(filled, (width * h < height * w ? NARROW_CROP : CROP) * whole);
    const zoom = fieldOfView === null ? fill : height / 2 / Math.tan(fieldOfView / 2) / K[4];
    return {
      viewmat,
      fx: K[0] * zoom,
      fy: K[4] * zoom,
      cx: width / 2 + (K[2] - w / 2) * zoom,
      cy: height / 2 + (K[5] - h / 2) * zoom,
      width,
      height,
      near: this.near,
    };
  }

  /**
   * Return where in the image of the reel's camera, 0 to 1 across its width, a narrow screen shall be centered because the focus is
   * there; null for the middle. m: pose [16] of the reel's camera.
   */
  centerOf(m: number[], focus: Vec3, width: number, height: number): number | null {
    const { home } = this;
    const { fx } = this.view(m, width, height);
    const [x, z] = [0, 8].map((i) => m[i] * focus[0] + m[i + 1] * focus[1] + m[i + 2] * focus[2] + m[i + 3]);
    const isWide = home.width * height <= CROP * home.height * width;
    if (isWide || z <= 0 || Math.abs((fx * x) / z) < (ASIDE * width) / 2) return null;
    return ((home.K[0] * x) / z + home.K[2]) / home.width;
  }
}

/** Rate at which a flick decays and a key accelerates, per second. */
const FRICTION = 6;
/** Rate at which the camera returns to its limits and a tilt decays, per second. */
const PULL = 5;

/** The camera that people steer. */
export class OrbitCamera {
  private readonly horizon: Horizon;
  private readonly framing: Framing;
  /** Near plane, in world units. */
  readonly near: number;
  private readonly limits: Limits;
  private start: CameraState;
  /** View of the reel's own camera. */
  readonly ownState: CameraState;
  /** Place in the image of the reel's camera on which the own view is centered, 0 to 1 across its width. */
  center = 0.5;
  private readonly poses: CameraState[];
  private eye: Vec3 = [0, 0, 0];
  private gaze!: Gaze;
  /** Distance to the pivot, which is straight ahead. */
  private distance = 1;
  /** Velocities that the pressed keys request. */
  private thrust: Motion = { ...STILL };
  /** True during a drag, while the limits do not pull. */
  private held = false;
  private velocity: Motion = { ...STILL };
  private glide: Glide | null = null;
  private followed: { path: CameraPath; at: number; cut: boolean } | null = null;
  private flythrough: CameraPath | null = null;
  /** True if people moved the camera to its present pose. */
  private moved = false;
  /** True once people have moved the camera. */
  touched = false;
  /** What moves the camera in place of orbits; null for orbits. */
  driver: CameraDriver | null = null;
  /** Bounds that a page declares; null for none. */
  bounds: OrbitBounds | null = null;
  /** Vertical field of view that a page declares, in radians; null for that of the reel. */
  fieldOfView: number | null = null;
  private spin: Spin | null = null;
  /** Seconds since people moved the camera. */
  private rested = 0;

  /** screen: size of the canvas, in CSS pixels. calm: disable inertia and transitions, for people who prefer reduced motion. */
  constructor(
    manifest: Manifest,
    screen?: { clientWidth: number; clientHeight: number },
    private readonly calm = false,
  ) {
    const { up, camera, cameras, near } = manifest;
    this.horizon = new Horizon(normalize(up));
    // Nearer than the near plane of training, since people walk up to objects.
    this.near = 0.4 * near;
    this.framing = new Framing(camera, this.near);
    this.limits = new Limits(manifest);
    this.start = this.stateOf(camera);
    this.poses = cameras.map((item) => this.level(this.stateOf(item)));
    this.state = this.start;
    if (screen) this.fit(screen.clientWidth, screen.clientHeight);
    this.ownState = this.start;
  }

  get viewmat(): number[] {
    return viewmatOf(this.eye, ...this.axes);
  }

  /** Set a pose [16], world to camera. The distance of the pivot does not change. */
  set viewmat(m: number[]) {
    this.state = { eye: eyeOf(m), turn: turnOf(m), distance: this.distance };
  }

  get state(): CameraState {
    return { eye: this.eye, turn: this.horizon.turnOf(this.gaze), distance: this.distance };
  }

  set state(state: CameraState) {
    [this.glide, this.followed, this.moved] = [null, null, false];
    this.velocity = { ...STILL };
    this.place(state);
  }

  /** True while the view is the one that the camera started with. */
  get atStart(): boolean {
    return !this.touched && !this.followed && !this.glide && length(subtract(this.eye, this.start.eye)) === 0;
  }

  /** True while the view is the reel's own. */
  get atOwnView(): boolean {
    const {
      ownState: { eye, turn },
      state,
    } = this;
    return length(subtract(state.eye, eye)) === 0 && turn.every((value, i) => Math.abs(state.turn[i] - value) < 1e-6);
  }

  /** Set the view of the start and of `reset`. The camera goes there if it is still at its start. */
  startAt(state: CameraState): void {
    const move = this.atStart;
    this.start = state;
    if (move) this.state = state;
  }

  /** Rotate while nobody moves the camera; null to stop. */
  rotate(spin: Spin | null): void {
    [this.spin, this.rested] = [spin, 0];
  }

  /** Center the first view on the focus if a narrow screen crops much of the image. */
  private fit(width: number, height: number): void {
    const {
      horizon,
      gaze,
      limits: { focus },
    } = this;
    const center = this.framing.centerOf(this.viewmat, focus, width, height);
    if (center === null) return;
    this.center = center;
    const turn = horizon.turnOf({ ...gaze, heading: horizon.toward(gaze, subtract(focus, this.eye)).heading });
    this.state = this.start = { ...this.start, turn };
  }

  /** Return to the reel's own camera, made level. */
  reset(): void {
    this.glideTo(this.level(this.start));
  }

  /** Go to the camera of the capture that is `step` after the nearest one, made level. */
  visit(step: number): void {
    const { poses } = this;
    if (poses.length === 0) return;
    const here = this.glide?.to.eye ?? this.eye;
    const distances = poses.map((pose) => length(subtract(pose.eye, here)));
    const nearest = distances.indexOf(Math.min(...distances));
    this.glideTo(poses[(nearest + step + poses.length) % poses.length]);
  }

  /** The path being followed, and its time. */
  get following(): Readonly<{ path: CameraPath; at: number }> | null {
    return this.followed;
  }

  /** Follow a path from time `at` on, until people move the camera; null to stop. cut: jump between keyframes instead of moving. */
  follow(path: CameraPath | null, at = 0, cut = false): void {
    [this.glide, this.moved, this.followed] = [null, false, path && { path, at, cut }];
    this.velocity = { ...STILL };
  }

  get flying(): boolean {
    return this.flythrough !== null && this.followed?.path === this.flythrough;
  }

  /** Fly through the cameras of the capture, or stop. */
  fly(on: boolean): void {
    this.flythrough =
      on && this.poses.length > 1 ? CameraPath.through(this.viewmat, this.poses.map(viewmatOfState)) : null;
    this.follow(this.flythrough, 0, this.calm);
  }

  /** Turn to a point in camera coordinates, and make it the pivot. */
  focus([x, y, z]: Vec3): void {
    const [right, down, forward] = this.axes;
    const way = add(add(scale(right, x), scale(down, y)), scale(forward, z));
    const { eye, horizon, gaze } = this;
    this.touched = true;
    this.glideTo({ eye, turn: horizon.turnOf(horizon.level(horizon.toward(gaze, way))), distance: length(way) });
  }

  /** Rotate about the pivot, in radians. Positive yaw moves the image to the right, positive pitch down. */
  orbit(yaw: number, pitch: number): void {
    this.touch();
    this.turn(this.horizon.turned(this.gaze, -yaw, -pitch));
  }

  /** Look in another direction from around the pivot, within the declared bounds. */
  private turn(gaze: Gaze): void {
    const { pivot, bounds } = this;
    this.gaze = bounds ? bounds.gaze(gaze) : gaze;
    this.eye = subtract(pivot, this.ahead);
  }

  /** Translate so that the pivot moves by pixels. focal: focal length in pixels. */
  pan(dx: number, dy: number, focal: number): void {
    this.walk(-dx / focal, -dy / focal, 0);
  }

  /** Translate view and pivot, in units of the pivot distance. */
  walk(right: number, down: number, forward: number): void {
    this.touch();
    const [x, y, z] = this.axes;
    this.eye = add(this.eye, scale(add(add(scale(x, right), scale(y, down)), scale(z, forward)), this.distance));
  }

  /** Multiply the distance to the pivot. */
  zoom(factor: number): void {
    this.touch();
    const { pivot, bounds } = this;
    const distance = Math.max(this.distance * factor, 0.01 * this.limits.extent);
    this.distance = bounds ? bounds.distance(distance) : distance;
    this.eye = subtract(pivot, this.ahead);
  }

  /** Set the velocities of the pressed keys; null for none. */
  steer(motion: Motion | null): void {
    this.thrust = motion ?? { ...STILL };
  }

  /** Begin a drag: stop all motion. */
  hold(): void {
    this.flick(0, 0);
    this.held = true;
  }

  /** End a drag. */
  release(): void {
    this.held = false;
  }

  /** Continue a drag with this angular velocity, in radians per second. */
  flick(yaw: number, pitch: number): void {
    this.velocity = this.calm ? { ...STILL } : { ...STILL, yaw, pitch };
  }

  /** Advance all motion. Returns true while the camera moves. */
  step(seconds: number): boolean {
    const driven = this.driver?.step(this.sight, this.thrust, seconds);
    if (driven) return this.drive(driven);
    if (this.followed) return this.stepAlong(this.followed, seconds);
    if (this.glide) return this.stepGlide(this.glide, seconds);
    if (this.driver) return false;
    const { velocity, thrust } = this;
    const gain = this.calm ? 1 : 1 - Math.exp(-FRICTION * seconds);
    for (const axis of AXES) velocity[axis] += (thrust[axis] - velocity[axis]) * gain;
    const moving = AXES.some((axis) => Math.abs(velocity[axis]) > 0.02 || thrust[axis] !== 0);
    if (!moving) this.velocity = { ...STILL };
    else {
      const by = (axis: keyof Motion): number => velocity[axis] * seconds;
      if (by("yaw") || by("pitch")) this.orbit(by("yaw"), by("pitch"));
      if (by("right") || by("down") || by("forward")) this.walk(by("right"), by("down"), by("forward"));
      if (by("zoom")) this.zoom(Math.exp(by("zoom")));
    }
    const upright = this.stepUpright(seconds);
    return this.stepSpin(seconds) || this.stepBack(seconds) || upright || moving;
  }

  private drive(sight: Sight): boolean {
    this.touch();
    this.sight = sight;
    return true;
  }

  private get sight(): Sight {
    const { eye, gaze, distance } = this;
    return { eye, gaze, distance };
  }

  private set sight({ eye, gaze, distance }: Sight) {
    [this.eye, this.gaze, this.distance] = [eye, gaze, distance];
  }

  /** Rotate after a rest, to and fro between bounds. */
  private stepSpin(seconds: number): boolean {
    const { spin, calm, held, gaze, distance } = this;
    if (!spin || calm || held || (this.rested += seconds) <= spin.delay) return false;
    const next = this.horizon.turned(gaze, spin.speed * seconds, 0);
    const allowed = this.bounds ? this.bounds.gaze(next) : next;
    const eye = subtract(this.pivot, scale(this.horizon.forwardOf(allowed), distance));
    const beyond = length(subtract(this.limits.eye(eye), eye)) > 1e-3 * this.limits.extent;
    if (
      allowed !== next ||
      (beyond && length(subtract(this.limits.eye(this.eye), this.eye)) <= 1e-3 * this.limits.extent)
    )
      spin.speed = -spin.speed;
    else this.turn(next);
    this.moved = true; // the horizon becomes level, and the limits hold
    return true;
  }

  /** Return the view for an image of width x height pixels, with the field of view of the reel's camera. */
  view(width: number, height: number): View {
    return this.framing.view(this.viewmat, width, height, this.fieldOfView);
  }

  /** Axes of the camera: x right, y down, z forward. */
  private get axes(): [Vec3, Vec3, Vec3] {
    return axesOf(this.horizon.turnOf(this.gaze));
  }

  /** Vector from the eye to the pivot. */
  private get ahead(): Vec3 {
    return scale(this.horizon.forwardOf(this.gaze), this.distance);
  }

  private get pivot(): Vec3 {
    return add(this.eye, this.ahead);
  }

  /** Record that people move the camera, and stop all other motion. */
  private touch(): void {
    [this.glide, this.followed, this.moved, this.touched, this.rested] = [null, null, true, true, 0];
  }

  private place({ eye, turn, distance }: CameraState): void {
    this.sight = { eye, gaze: this.horizon.gazeOf(turn), distance };
  }

  private level(state: CameraState): CameraState {
    const { horizon } = this;
    return { ...state, turn: horizon.turnOf(horizon.level(horizon.gazeOf(state.turn))) };
  }

  /** Return the state of a camera of the capture. Its pivot is at the depth of the scene's center. */
  private stateOf({ viewmat: m }: Pick<Camera, "viewmat">): CameraState {
    const { center, extent } = this.limits;
    const ahead = dot(subtract(center, eyeOf(m)), [m[8], m[9], m[10]]);
    return { eye: eyeOf(m), turn: turnOf(m), distance: ahead > 0.05 * extent ? ahead : 0.5 * extent };
  }

  private glideTo(to: CameraState): void {
    this.follow(null);
    this.glide = new Glide(this.horizon, this.sight, { ...to, gaze: this.horizon.gazeOf(to.turn) }, this.calm);
  }

  private stepGlide(glide: Glide, seconds: number): boolean {
    this.sight = glide.step(seconds);
    if (glide.over) this.glide = null;
    return true;
  }

  private stepAlong(followed: { path: CameraPath; at: number; cut: boolean }, seconds: number): boolean {
    followed.at += seconds;
    const { path, at, cut } = followed;
    const { tilt } = this.gaze;
    this.place(this.stateOf(path.at(at, cut)));
    // A flight through the cameras becomes level after its start.
    if (path === this.flythrough) this.gaze = this.righted({ ...this.gaze, tilt }, seconds);
    if (!path.loop && at >= path.seconds) this.followed = null;
    return true;
  }

  /** Fade of the image, 0 to 1, for views far from those of the capture's cameras. */
  get offCameraFade(): number {
    return this.moved ? this.limits.fade(this.eye) : 0;
  }

  /** Return to the limits after a drag ends; to the floor at once. */
  private stepBack(seconds: number): boolean {
    if (!this.moved) return false;
    const { limits, held } = this;
    const gain = this.calm ? 1 : 1 - Math.exp(-PULL * seconds);
    const { pivot } = this;
    const shift = scale(subtract(held ? pivot : limits.middle(pivot), pivot), gain);
    this.eye = add(this.eye, shift);
    const eye = held ? limits.above(this.eye, gain) : limits.eye(this.eye, gain);
    if (length(shift) + length(subtract(eye, this.eye)) <= 1e-4 * limits.extent) return false;
    const to = subtract(add(pivot, shift), eye);
    [this.eye, this.distance, this.gaze] = [eye, length(to), this.horizon.toward(this.gaze, to)];
    return true;
  }

  /** Level the horizon once people move the camera, since cameras of captures are slightly tilted. */
  private stepUpright(seconds: number): boolean {
    if (!this.moved || this.horizon.isLevel(this.gaze)) return false;
    this.gaze = this.righted(this.gaze, seconds);
    return true;
  }

  private righted(gaze: Gaze, seconds: number): Gaze {
    return this.horizon.righted(gaze, this.calm ? 1 : 1 - Math.exp(-PULL * seconds));
  }
}
