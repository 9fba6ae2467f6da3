/** Draws a camera path over the picture: its curve, and a small camera at each keyframe. */
import { add, dot, eyeOf, length, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { View } from "@splatreel/renderer";
import type { CameraPath } from "../camera/camera-path";
import type { OrbitCamera } from "../camera/orbit-camera";

/** Points of the curve between keyframes, and their maximum number in total. */
const FINE = 16;
const MOST = 600;
/** Size of the drawn cameras, relative to the extent of the path. */
const SIZE = 0.06;

const SVG = "http://www.w3.org/2000/svg";

/** SVG overlay of a path. */
export class PathDrawing {
  readonly box = document.createElementNS(SVG, "svg");
  private readonly parts: SVGPathElement[];
  private readonly labels = document.createElementNS(SVG, "g");

  constructor() {
    this.box.setAttribute("aria-hidden", "true");
    this.box.classList.add("path-drawing");
    // Each line is drawn twice, with a dark one below, so that it is visible on any background.
    this.parts = ["under", "curve", "under", "cameras"].map((name) => {
      const path = document.createElementNS(SVG, "path");
      path.classList.add(name);
      return path;
    });
    this.box.append(...this.parts, this.labels);
  }

  /** Draw a path as seen by the camera, or nothing for null. width, height: CSS pixels. */
  draw(path: CameraPath | null, camera: OrbitCamera, width: number, height: number): void {
    this.box.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const view = camera.view(width, height);
    const eyes = path?.keyframes.map(({ viewmat }) => eyeOf(viewmat)) ?? [];
    const curve = path ? lineOf(curveOf(path), view) : "";
    const size = SIZE * widest(eyes) || 0.05 * camera.state.distance;
    const cameras = (path?.keyframes ?? [])
      .flatMap(({ viewmat }) => cameraAt(viewmat, size).map((line) => lineOf(line, view)))
      .join("");
    for (const [i, shape] of [curve, curve, cameras, cameras].entries()) this.parts[i].setAttribute("d", shape);
    this.labels.replaceChildren(...eyes.flatMap((eye, i) => label(String(i + 1), eye, view)));
  }
}

function widest(points: Vec3[]): number {
  return Math.max(0, ...points.map((point) => length(subtract(point, points[0]))));
}

function curveOf(path: CameraPath): Vec3[] {
  const legs = path.keyframes.length - 1;
  const count = Math.min(legs * FINE, MOST);
  return Array.from({ length: count + 1 }, (_, i) => {
    const place = (i / Math.max(count, 1)) * legs;
    const leg = Math.min(Math.floor(place), legs - 1);
    if (leg < 0) return eyeOf(path.keyframes[0].viewmat);
    const [from, to] = [path.keyframes[leg].at, path.keyframes[leg + 1].at];
    // Stop before the end, where a loop would restart.
    return eyeOf(path.at(from + (to - from) * Math.min(place - leg, 1 - 1e-9)).viewmat);
  });
}

/** Return the lines of a view pyramid. */
function cameraAt(m: number[], size: number): Vec3[][] {
  const eye = eyeOf(m);
  const [right, down, forward] = [0, 4, 8].map((i) => m.slice(i, i + 3) as Vec3);
  const corner = (x: number, y: number): Vec3 =>
    add(eye, add(add(scale(right, 0.6 * x * size), scale(down, 0.4 * y * size)), scale(forward, size)));
  const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
  return [
    [...corners, corners[0]],
    ...corners.map((point) => [eye, point]),
    [corner(-0.4, -1), corner(0, -1.5), corner(0.4, -1)],
  ];
}

/** Return the part of a line in front of the viewer, as SVG path data. */
export function lineOf(points: Vec3[], view: View): string {
  const { viewmat: m, near } = view;
  const seen = points.map((point) => [0, 4, 8].map((i) => dot(point, m.slice(i, i + 3) as Vec3) + m[i + 3]) as Vec3);
  let shape = "";
  let drawing = false;
  for (let i = 1; i < seen.length; i++) {
    let [a, b] = [seen[i - 1], seen[i]];
    if (a[2] < near && b[2] < near) {
      drawing = false;
      continue;
    }
    const cut = (behind: Vec3, before: Vec3): Vec3 =>
      add(behind, scale(subtract(before, behind), (near - behind[2]) / (before[2] - behind[2])));
    if (a[2] < near) [a, drawing] = [cut(a, b), false];
    const leaves = b[2] < near;
    if (leaves) b = cut(b, a);
    shape += `${drawing ? "" : `M${pixel(a, view)}`}L${pixel(b, view)}`;
    drawing = !leaves;
  }
  return shape;
}

/** Return a point of camera space in pixels, as text for a path. */
export function pixel([x, y, z]: Vec3, { fx, fy, cx, cy }: View): string {
  const shown = (value: number): string => Math.min(Math.max(value, -1e5), 1e5).toFixed(1);
  return `${shown((fx * x) / z + cx)} ${shown((fy * y) / z + cy)}`;
}

function label(text: string, point: Vec3, view: View): SVGTextElement[] {
  const { viewmat: m, near } = view;
  const place = [0, 4, 8].map((i) => dot(point, m.slice(i, i + 3) as Vec3) + m[i + 3]) as Vec3;
  if (place[2] < near) return [];
  const [x, y] = pixel(place, view).split(" ");
  const element = document.createElementNS(SVG, "text");
  element.setAttribute("x", x);
  element.setAttribute("y", y);
  element.textContent = text;
  return [element];
}
