/**
 * Cameras that a page declares, as in `<model-viewer>`: `camera-orbit="45deg 80deg 2"`, `camera-target`, `field-of-view`, and bounds.
 * Azimuths are counted from the reel's own camera, counterclockwise as seen from above; inclinations from straight above. Distances
 * and positions are in units of the reel, or in percent of the reel's own distance.
 */
import {
  add,
  cross,
  dot,
  eyeOf,
  type Manifest,
  normalize,
  rotate,
  scale,
  subtract,
  type Vec3,
} from "@splatreel/decoder/internal";
import { Horizon, type Gaze } from "./horizon";
import type { CameraState } from "./pose";

/** An attribute that cannot be used. The message names the value and the remedy. */
export class DeclarationError extends Error {}

/** Steepest inclinations, so that a level horizon exists. */
const STEEPEST: [number, number] = [0.1, Math.PI - 0.1];

/** Bounds of orbits that a page declares. */
export interface OrbitBounds {
  gaze(gaze: Gaze): Gaze;
  distance(distance: number): number;
}

/** An orbit: azimuth and inclination in radians, and distance, each null for "auto". */
export interface Orbit {
  theta: number | null;
  phi: number | null;
  /** In units of the reel, or relative to its own distance. */
  radius: { value: number; relative: boolean } | null;
}

/** Parse an angle with its unit, in radians; null for "auto". */
export function parseAngle(text: string): number | null {
  if (text === "auto") return null;
  const match = /^([-+]?(?:\d+\.?\d*|\.\d+))(deg|rad)$/.exec(text);
  if (!match)
    throw new DeclarationError(`"${text}" is not an angle. Write it with its unit, such as 45deg or 0.8rad, or auto`);
  return Number(match[1]) * (match[2] === "deg" ? Math.PI / 180 : 1);
}

/** Parse three values: azimuth, inclination, distance. */
export function parseOrbit(text: string): Orbit {
  const parts = partsOf(text);
  if (parts.length !== 3)
    throw new DeclarationError(
      `"${text}" must hold three values: azimuth, inclination and distance, such as 45deg 80deg 2`,
    );
  const match = parts[2] === "auto" ? null : /^(\d+\.?\d*|\.\d+)(m|%)?$/.exec(parts[2]);
  if (parts[2] !== "auto" && !(match && Number(match[1]) > 0))
    throw new DeclarationError(`"${parts[2]}" is not a distance. Write a number above 0, such as 2 or 105%, or auto`);
  const radius = match && { value: Number(match[1]) / (match[2] === "%" ? 100 : 1), relative: match[2] === "%" };
  return { theta: parseAngle(parts[0]), phi: parseAngle(parts[1]), radius };
}

/** Parse a position in the reel; null for "auto". */
export function parseTarget(text: string): Vec3 | null {
  const parts = partsOf(text);
  if (parts.join() === "auto" || parts.join() === "auto,auto,auto") return null;
  const numbers = parts.map((part) => Number(part.replace(/m$/, "") || NaN));
  if (numbers.length !== 3 || !numbers.every(Number.isFinite))
    throw new DeclarationError(`"${text}" is not a position. Write three numbers, such as 0 1.5 -2, or auto`);
  return numbers as Vec3;
}

/** Parse a vertical field of view in radians; null for "auto". */
export function parseFieldOfView(text: string): number | null {
  const angle = parseAngle(text.trim());
  if (angle !== null && !(angle >= Math.PI / 180 && angle <= (170 * Math.PI) / 180))
    throw new DeclarationError(`"${text}" is not a field of view. Write an angle from 1deg to 170deg`);
  return angle;
}

function partsOf(text: string): string[] {
  return text.trim().split(/\s+/);
}

/** Orbits about a target in one reel. */
export class OrbitFrame {
  private readonly horizon: Horizon;
  private readonly up: Vec3;
  private readonly own: Gaze;
  private readonly target: Vec3;
  private readonly distance: number;

  /** own: the reel's view, whose pivot is the default target. */
  constructor({ up, camera }: Pick<Manifest, "up" | "camera">, own: CameraState, target: Vec3 | null) {
    this.up = normalize(up);
    this.horizon = new Horizon(this.up);
    this.own = this.horizon.level(this.horizon.gazeOf(own.turn));
    this.target = target ?? add(own.eye, scale(this.horizon.forwardOf(this.own), own.distance));
    this.distance = target
      ? Math.max(dot(subtract(target, eyeOf(camera.viewmat)), this.horizon.forwardOf(this.own)), 0.1 * own.distance)
      : own.distance;
  }

  /** Return the level view of an orbit. */
  stateOf({ theta, phi, radius }: Orbit): CameraState {
    const heading = rotate(this.own.heading, this.up, theta ?? 0);
    const pitch = phi === null ? this.own.pitch : within(phi, ...STEEPEST) - Math.PI / 2;
    const gaze = this.horizon.level({ ...this.own, heading, pitch });
    const distance = this.radiusOf(radius) ?? this.distance;
    return {
      eye: subtract(this.target, scale(this.horizon.forwardOf(gaze), distance)),
      turn: this.horizon.turnOf(gaze),
      distance,
    };
  }

  /** Return the bounds between two orbits, whose "auto" means none. Throws `DeclarationError` if a minimum exceeds its maximum. */
  boundsOf(least: Orbit, most: Orbit): OrbitBounds {
    const azimuths: [number, number] = [least.theta ?? -Infinity, most.theta ?? Infinity];
    const inclinations: [number, number] = [least.phi ?? 0, most.phi ?? Math.PI];
    const distances: [number, number] = [this.radiusOf(least.radius) ?? 0, this.radiusOf(most.radius) ?? Infinity];
    for (const [name, [low, high]] of Object.entries({
      azimuth: azimuths,
      inclination: inclinations,
      distance: distances,
    })) {
      if (low > high) throw new DeclarationError(`the smallest ${name} is larger than the largest. Exchange them`);
    }
    const middle = (azimuths[0] + azimuths[1]) / 2;
    return {
      distance: (distance) => within(distance, ...distances),
      gaze: (gaze) => {
        const azimuth = this.azimuthOf(gaze, Number.isFinite(middle) ? middle : 0);
        const allowed = within(azimuth, ...azimuths);
        const pitch = within(gaze.pitch, inclinations[0] - Math.PI / 2, inclinations[1] - Math.PI / 2);
        if (allowed === azimuth && pitch === gaze.pitch) return gaze;
        return { ...gaze, heading: rotate(gaze.heading, this.up, allowed - azimuth), pitch };
      },
    };
  }

  /** Return the azimuth of a view, within half a turn of `middle`. */
  private azimuthOf({ heading }: Gaze, middle: number): number {
    const { own, up } = this;
    const angle = Math.atan2(dot(cross(own.heading, heading), up), dot(own.heading, heading));
    return angle + 2 * Math.PI * Math.round((middle - angle) / (2 * Math.PI));
  }

  private radiusOf(radius: Orbit["radius"]): number | null {
    return radius && radius.value * (radius.relative ? this.distance : 1);
  }
}

function within(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}
