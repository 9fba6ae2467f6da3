/** Elements of the page at points of the scene, for a part of the time. This part is loaded on demand. */
import { messageOf, type Vec3 } from "@splatreel/decoder/internal";
import type { View } from "@splatreel/renderer";
import type { Player } from "../player/player";
import styles from "./annotations.css";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";

/** Position in the pixels of a view, and depth in front of the camera, in world units. */
export interface Place {
  x: number;
  y: number;
  depth: number;
}

/** Return where a view shows a point; null if the point is behind the camera or outside of the picture. */
export function placeOfPoint({ viewmat: m, fx, fy, cx, cy, width, height, near }: View, point: Vec3): Place | null {
  const [x, y, depth] = [0, 4, 8].map(
    (row) => m[row] * point[0] + m[row + 1] * point[1] + m[row + 2] * point[2] + m[row + 3],
  );
  if (depth <= near) return null;
  const place = { x: (fx * x) / depth + cx, y: (fy * y) / depth + cy, depth };
  return place.x >= 0 && place.x <= width && place.y >= 0 && place.y <= height ? place : null;
}

/** Milliseconds without a new picture after which points in front are looked for, since that reads the picture back. */
const REST = 250;
/** Points in front hide an annotation if they are nearer than this part of its depth. */
const IN_FRONT = 0.95;

interface Annotation {
  box: HTMLElement;
  point: Vec3;
  /** Seconds between which it is shown. */
  time: [number, number];
  place: Place | null;
}

/** The annotations of one element. */
export class Annotations {
  private readonly holder = elementOf(`<div class="annotations"></div>`);
  private list: Annotation[] = [];
  private timer = 0;

  constructor(
    private readonly host: HTMLElement,
    root: ShadowRoot,
    private readonly player: Player,
    signal: AbortSignal,
  ) {
    adoptStyles(root, styles);
    root.querySelector(".poster")!.after(this.holder);
    for (const name of ["drawn", "timeupdate", "emptied"])
      player.addEventListener(name, () => this.place(), { signal });
    signal.addEventListener("abort", () => {
      clearTimeout(this.timer);
      this.holder.remove();
    });
    this.read();
  }

  /** Read the children again, after they changed. */
  read(): void {
    this.list = [...this.host.querySelectorAll<HTMLElement>(':scope > [slot^="annotation-"]')].flatMap((element) => {
      const box = elementOf(`<div class="annotation" hidden><slot></slot></div>`);
      box.querySelector("slot")!.name = element.slot;
      try {
        return [
          {
            box,
            point: parsePoint(element.dataset.position ?? ""),
            time: parseTime(element.dataset.time),
            place: null,
          },
        ];
      } catch (error) {
        console.warn(`slot="${element.slot}" of <splat-reel>: ${messageOf(error)}. The annotation is not shown.`);
        return [];
      }
    });
    this.holder.replaceChildren(...this.list.map(({ box }) => box));
    this.place();
  }

  /** Place the annotations on the present picture. */
  private place(): void {
    const {
      player,
      player: { camera, canvas, currentTime },
    } = this;
    const view = player.playback.hasPicture ? camera?.view(canvas.clientWidth, canvas.clientHeight) : null;
    for (const annotation of this.list) {
      const {
        box,
        point,
        time: [start, end],
      } = annotation;
      const place = (annotation.place =
        view && currentTime >= start && currentTime <= end ? placeOfPoint(view, point) : null);
      box.hidden = !place;
      if (place)
        box.style.transform = `translate(${place.x.toFixed(1)}px, ${place.y.toFixed(1)}px) translate(-50%, -50%)`;
    }
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.hideThoseBehind(), REST);
  }

  /** Hide annotations behind points, once the picture is still. */
  private hideThoseBehind(): void {
    const { stage, canvas } = this.player;
    const view = stage?.view;
    if (!view || stage.lost) return;
    const ratio = view.width / canvas.clientWidth;
    for (const { box, place } of this.list) {
      if (!place) continue;
      const depth = stage.depthAt(place.x * ratio, place.y * ratio);
      box.classList.toggle("behind", depth !== null && depth < IN_FRONT * place.depth);
    }
  }
}

/** Parse a position of three numbers. */
export function parsePoint(text: string): Vec3 {
  const numbers = text
    .trim()
    .split(/\s+/)
    .map((part) => Number(part || NaN));
  if (numbers.length !== 3 || !numbers.every(Number.isFinite))
    throw new Error(`data-position="${text}" is not a position. Write three numbers, such as 0 1.5 -2`);
  return numbers as Vec3;
}

/** Parse the seconds of start and end; without a text it is always shown. */
export function parseTime(text: string | undefined): [number, number] {
  if (text === undefined) return [-Infinity, Infinity];
  const numbers = text
    .trim()
    .split(/\s+/)
    .map((part) => Number(part || NaN));
  if (numbers.length !== 2 || !(numbers[0] <= numbers[1]))
    throw new Error(`data-time="${text}" is not a part of the time. Write the seconds of start and end, such as 1.5 3`);
  return numbers as [number, number];
}
