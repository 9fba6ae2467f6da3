/** A camera that orbits a pivot, with inertia and soft limits. It starts exactly at a camera of the reel. */
import { Flight } from "./flight";
import type { Camera, Manifest } from "./manifest";
import { add, cross, dot, eyeOf, length, normalize, rotate, scale, subtract, viewmatOf, type Vec3 } from "./matrix";
import { between, type CameraState } from "./pose";
import { axesOf, quatOf, type Quat } from "./quaternion";
import type { View } from "./renderer";

/** How fast a flick dies away and a key takes hold, per second. */
const FRICTION = 6;
/** How fast the camera comes back from beyond its limits, per second. */
const PULL = 5;
/** Closest the view comes to straight up or down, radians. */
const POLE = 0.1;
/** Seconds a change of pose takes. */
const GLIDE = 0.5;

/** Velocities: turns about the pivot (radians a second), moves (pivot distances a second), zoom (factors of e a second). */
export interface Motion {
  yaw: number;
  pitch: number;
  right: number;
  down: number;
  forward: number;
  zoom: number;
}

const STILL: Motion = { yaw: 0, pitch: 0, right: 0, down: 0, forward: 0, zoom: 0 };
const AXES = Object.keys(STILL) as (keyof Motion)[];

export class OrbitCamera {
  /** No inertia, no gliding: for people who asked for less motion. */
  calm = false;
  /** What keys ask for; zero when none is down. */
  thrust: Motion = { ...STILL };
  /** A hand holds the picture: limits wait. */
  held = false;

  private readonly up: Vec3;
  private readonly home: Camera;
  private readonly extent: number;
  /** Least depth to draw, world units. */
  readonly near: number;
  private readonly bounds: [Vec3, Vec3];
  private readonly center: Vec3;
  /** How far from the center people may go. */
  private readonly reach: number;
  private readonly start: CameraState;
  private readonly poses: CameraState[];
  private pivot: Vec3 = [0, 0, 0];
  private eye: Vec3 = [0, 0, 0];
  private right: Vec3 = [1, 0, 0];
  private down: Vec3 = [0, 1, 0];
  private forward: Vec3 = [0, 0, 1];
  private velocity: Motion = { ...STILL };
  private glide: { from: CameraState; to: CameraState; at: number } | null = null;
  private flight: { path: Flight; at: number } | null = null;
  private moved = false;

  constructor({ bounds, up, camera, cameras, near }: Manifest) {
    const [low, high] = bounds;
    this.bounds = bounds;
    this.up = normalize(up);
    this.home = camera;
    // Nearer than the capture was trained to be drawn: people walk up to things.
    this.near = 0.4 * near;
    this.extent = Math.max(length(subtract(high, low)), 1e-6);
    this.center = scale(add(low, high), 0.5);
    const eyes = [camera, ...cameras].map(({ viewmat }) => eyeOf(viewmat));
    this.reach = 1.5 * Math.max(...[low, high, ...eyes].map((point) => length(subtract(point, this.center))));
    this.start = this.stateOf(camera);
    this.poses = cameras.map((item) => this.stateOf(item));
    this.state = this.start;
  }

  get viewmat(): number[] {
    return viewmatOf(this.eye, this.right, this.down, this.forward);
  }

  /** Take a pose [16], world to camera; the pivot stays at its distance in front. */
  set viewmat(m: number[]) {
    this.state = { eye: eyeOf(m), turn: turnOf(m), distance: this.distance };
  }

  get state(): CameraState {
    return { eye: this.eye, turn: quatOf([this.right, this.down, this.forward]), distance: this.distance };
  }

  set state(state: CameraState) {
    [this.glide, this.flight, this.moved] = [null, null, false];
    this.velocity = { ...STILL };
    this.place(state);
  }

  /** Back to the reel's own camera. */
  reset(): void {
    this.glideTo(this.start);
  }

  /** Go to the camera of the capture that is `step` beyond the nearest one. */
  visit(step: number): void {
    const { poses } = this;
    if (poses.length === 0) return;
    const here = this.glide?.to.eye ?? this.eye;
    const distances = poses.map((pose) => length(subtract(pose.eye, here)));
    const nearest = distances.indexOf(Math.min(...distances));
    this.glideTo(poses[(nearest + step + poses.length) % poses.length]);
  }

  get flying(): boolean {
    return this.flight !== null;
  }

  /** Fly through the cameras of the capture, or stop. */
  fly(on: boolean): void {
    this.glide = null;
    this.flight = on && this.poses.length > 1 ? { path: new Flight(this.state, this.poses), at: 0 } : null;
  }

  /** Turn to a point seen at camera coordinates, and orbit about it from now on. */
  focus([x, y, z]: Vec3): void {
    const point = add(add(this.eye, scale(this.right, x)), add(scale(this.down, y), scale(this.forward, z)));
    const forward = normalize(subtract(point, this.eye));
    const axis = cross(this.forward, forward);
    const angle = Math.atan2(length(axis), dot(this.forward, forward));
    const turned = (v: Vec3): Vec3 => (angle > 1e-6 ? rotate(v, normalize(axis), angle) : v);
    this.glideTo({ eye: this.eye, turn: quatOf([turned(this.right), turned(this.down), forward]), distance: length(subtract(point, this.eye)) });
  }

  /** Turn about the pivot, in radians: positive yaw moves the picture to the right, positive pitch down. */
  orbit(yaw: number, pitch: number): void {
    this.touch();
    const angle = Math.acos(Math.min(Math.max(dot(this.forward, this.up), -1), 1));
    // A positive turn about `right` lifts the forward axis, and so shrinks its angle to up.
    const turn = Math.min(Math.max(-pitch, Math.min(angle - Math.PI + POLE, 0)), Math.max(angle - POLE, 0));
    const about = (v: Vec3): Vec3 => rotate(rotate(v, this.right, turn), this.up, -yaw);
    const back = about(subtract(this.eye, this.pivot));
    [this.right, this.down, this.forward] = [about(this.right), about(this.down), about(this.forward)];
    this.forward = normalize(this.forward);
    this.right = normalize(cross(this.down, this.forward));
    this.down = cross(this.forward, this.right);
    this.eye = add(this.pivot, back);
  }

  /** Shift view and pivot so that the pivot moves by pixels on a screen of this focal length. */
  pan(dx: number, dy: number, focal: number): void {
    this.walk(-dx / focal, -dy / focal, 0);
  }

  /** Shift view and pivot, in distances of the pivot. */
  walk(right: number, down: number, forward: number): void {
    this.touch();
    const shift = scale(add(add(scale(this.right, right), scale(this.down, down)), scale(this.forward, forward)), this.distance);
    this.eye = add(this.eye, shift);
    this.pivot = add(this.pivot, shift);
  }

  /** Multiply the distance to the pivot. */
  zoom(factor: number): void {
    this.touch();
    const back = subtract(this.eye, this.pivot);
    const distance = length(back);
    this.eye = add(this.pivot, scale(back, Math.max(distance * factor, 0.01 * this.extent) / distance));
  }

  /** Let a drag go on with this angular velocity (radians a second). */
  flick(yaw: number, pitch: number): void {
    this.velocity = this.calm ? { ...STILL } : { ...STILL, yaw, pitch };
  }

  /** Advance what moves by itself; true while the camera does. */
  step(seconds: number): boolean {
    if (this.flight) {
      this.flight.at += seconds;
      this.place(this.flight.path.at(this.flight.at, this.calm));
      return true;
    }
    if (this.glide) return this.stepGlide(seconds);
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
    return this.stepBack(seconds) || moving;
  }

  /** The view in a picture of width x height pixels, its field of view that of the reel's camera. */
  view(width: number, height: number): View {
    const { K, width: w, height: h } = this.home;
    const whole = Math.min(width / w, height / h);
    const filled = Math.max(width / w, height / h);
    // Fill a screen of another shape where little is lost by it; never crop more than this.
    const zoom = Math.min(filled, 1.4 * whole);
    return {
      viewmat: this.viewmat,
      fx: K[0] * zoom,
      fy: K[4] * zoom,
      cx: width / 2 + (K[2] - w / 2) * zoom,
      cy: height / 2 + (K[5] - h / 2) * zoom,
      width,
      height,
      near: this.near,
    };
  }

  private get distance(): number {
    return length(subtract(this.pivot, this.eye));
  }

  /** A hand is on it: nothing else moves it any more. */
  private touch(): void {
    [this.glide, this.flight, this.moved] = [null, null, true];
  }

  private place({ eye, turn, distance }: CameraState): void {
    this.eye = eye;
    [this.right, this.down, this.forward] = axesOf(turn);
    this.pivot = add(eye, scale(this.forward, distance));
  }

  /** The pivot of a camera of the capture is what lies in the middle of the scene's depth. */
  private stateOf({ viewmat: m }: Camera): CameraState {
    const ahead = dot(subtract(this.center, eyeOf(m)), [m[8], m[9], m[10]]);
    return { eye: eyeOf(m), turn: turnOf(m), distance: ahead > 0.05 * this.extent ? ahead : 0.5 * this.extent };
  }

  private glideTo(to: CameraState): void {
    this.velocity = { ...STILL };
    this.flight = null;
    this.moved = false;
    this.glide = { from: this.state, to, at: this.calm ? 1 : 0 };
  }

  private stepGlide(seconds: number): boolean {
    const glide = this.glide!;
    glide.at = Math.min(glide.at + seconds / GLIDE, 1);
    const t = glide.at * glide.at * (3 - 2 * glide.at);
    this.place(t < 1 ? between(glide.from, glide.to, t) : glide.to);
    if (t === 1) this.glide = null;
    return true;
  }

  /** Come back from beyond the limits, once people have left them and let go. */
  private stepBack(seconds: number): boolean {
    if (!this.moved || this.held) return false;
    const gain = this.calm ? 1 : 1 - Math.exp(-PULL * seconds);
    const margin = 0.25 * this.extent;
    const [low, high] = this.bounds;
    const inside = this.pivot.map((value, a) => Math.min(Math.max(value, low[a] - margin), high[a] + margin)) as Vec3;
    const shift = scale(subtract(inside, this.pivot), gain);
    this.pivot = add(this.pivot, shift);
    this.eye = add(this.eye, shift);
    const out = subtract(this.eye, this.center);
    const excess = Math.max(1 - this.reach / Math.max(length(out), 1e-9), 0);
    // Towards the pivot, so that the view keeps its direction.
    const nearer = scale(subtract(this.pivot, this.eye), excess * gain);
    this.eye = add(this.eye, nearer);
    return length(shift) + length(nearer) > 1e-4 * this.extent;
  }
}

function turnOf(m: number[]): Quat {
  return quatOf([[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]]);
}
