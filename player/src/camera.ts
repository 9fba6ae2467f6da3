/** A camera that orbits a pivot, with inertia. It starts exactly at a camera of the reel. */
import type { Camera, Manifest } from "./manifest";
import { add, cross, dot, eyeOf, length, normalize, rotate, scale, subtract, viewmatOf, type Vec3 } from "./matrix";
import type { View } from "./renderer";

/** How fast a flick dies away, per second. */
const FRICTION = 6;
/** Closest the view comes to straight up or down, radians. */
const POLE = 0.1;

export class OrbitCamera {
  private readonly up: Vec3;
  private readonly home: Camera;
  private readonly extent: number;
  private readonly near: number;
  private readonly homePivot: Vec3;
  private pivot: Vec3 = [0, 0, 0];
  private eye: Vec3 = [0, 0, 0];
  private right: Vec3 = [1, 0, 0];
  private down: Vec3 = [0, 1, 0];
  private forward: Vec3 = [0, 0, 1];
  private spin: [number, number] = [0, 0];

  constructor(manifest: Manifest) {
    const [low, high] = manifest.bounds;
    const center = scale(add(low, high), 0.5);
    this.up = normalize(manifest.up);
    this.home = manifest.camera;
    // Nearer than the capture was trained to be drawn: people walk up to things.
    this.near = 0.2 * manifest.near;
    this.extent = Math.max(length(subtract(high, low)), 1e-6);
    const m = this.home.viewmat;
    const eye = eyeOf(m);
    const forward: Vec3 = [m[8], m[9], m[10]];
    const ahead = dot(subtract(center, eye), forward);
    this.homePivot = add(eye, scale(forward, ahead > 0.05 * this.extent ? ahead : 0.5 * this.extent));
    this.reset();
  }

  /** Back to the reel's own camera. */
  reset(): void {
    this.moveTo(this.home.viewmat, this.homePivot);
  }

  get viewmat(): number[] {
    return viewmatOf(this.eye, this.right, this.down, this.forward);
  }

  /** Take a pose [16], world to camera; the pivot stays at its distance in front. */
  set viewmat(m: number[]) {
    const distance = length(subtract(this.pivot, this.eye));
    this.moveTo(m, add(eyeOf(m), scale([m[8], m[9], m[10]], distance)));
  }

  /** Turn about the pivot, in radians: positive yaw moves the picture to the right, positive pitch down. */
  orbit(yaw: number, pitch: number): void {
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
    const unit = length(subtract(this.pivot, this.eye)) / focal;
    const shift = add(scale(this.right, -dx * unit), scale(this.down, -dy * unit));
    this.eye = add(this.eye, shift);
    this.pivot = add(this.pivot, shift);
  }

  /** Multiply the distance to the pivot, within the scene's reach. */
  zoom(factor: number): void {
    const back = subtract(this.eye, this.pivot);
    const distance = length(back);
    const next = Math.min(Math.max(distance * factor, 0.01 * this.extent), Math.max(5 * this.extent, distance));
    this.eye = add(this.pivot, scale(back, next / distance));
  }

  /** Let a drag go on with this angular velocity (radians a second). */
  flick(yaw: number, pitch: number): void {
    this.spin = [yaw, pitch];
  }

  /** Advance the inertia; true while the camera moves. */
  step(seconds: number): boolean {
    const [yaw, pitch] = this.spin;
    if (Math.hypot(yaw, pitch) < 0.02) return false;
    this.orbit(yaw * seconds, pitch * seconds);
    const keep = Math.exp(-FRICTION * seconds);
    this.spin = [yaw * keep, pitch * keep];
    return true;
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

  private moveTo(m: number[], pivot: Vec3): void {
    this.eye = eyeOf(m);
    [this.right, this.down, this.forward] = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
    this.pivot = pivot;
    this.spin = [0, 0];
  }
}
