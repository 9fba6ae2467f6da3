/** The scene on screen: sorted by the worker, drawn by the renderer. Each frame is drawn with an order that was sorted for it. */
import {
  add,
  clampFrame,
  type DecodedGroup,
  type DecodedLayer,
  eyeOf,
  groupAt,
  length,
  type Reel,
  scale,
  type Schedule,
  subtract,
  weightAt,
} from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { Cutaway } from "./cutaway";
import type { Eye } from "./eye";
import { covers } from "./frustum";
import type { PointSorter } from "./point-sorter";
import type { HeadsetLayer, Renderer } from "./renderer";
import type { Scene } from "./scene";

/** A rendered image: RGBA bytes, top row first. */
export interface Picture {
  width: number;
  height: number;
  data: Uint8Array;
}

/** Sorts scenes, and draws the sorted one when something changed. */
export class Stage {
  /** Scene of the order on the GPU. */
  scene: Scene | null = null;
  /** Duration of the last sort, in milliseconds. */
  sortMilliseconds = 0;
  /** Number of frames drawn so far. */
  pictures = 0;
  /** View of the last frame. */
  view: View | null = null;

  private drawnFrame = 0;
  private sortedFor: View | null = null;
  private needsSort = true;
  /** True until the order is drawn for the first time. */
  private isOrderNew = false;
  private needsDraw = false;
  private closed = false;
  private sorting: Scene | null = null;
  private reel: Reel | null = null;
  /** Schedule for which the order was sorted. A live reel may drop its groups from the next manifest. */
  private schedule: Schedule | null = null;

  constructor(
    private readonly renderer: Renderer,
    private readonly sorter: PointSorter,
  ) {}

  /** Begin to draw a reel. Throws `ReelError` if the device cannot draw. */
  open(reel: Reel): void {
    this.reel = reel;
    this.renderer.begin(reel.manifest.antialias === true, reel.manifest.background ?? [0, 0, 0]);
  }

  /** Show the page behind the points. */
  set transparent(on: boolean) {
    if (this.renderer.transparent === on) return;
    this.renderer.transparent = on;
    this.needsDraw = true;
  }

  /** Show the room behind the points in a headset. */
  set passthrough(on: boolean) {
    this.renderer.passthrough = on;
  }

  /** Leave points out of the picture; null draws all. */
  set cutaway(cutaway: Cutaway | null) {
    this.renderer.cutaway = cutaway;
    this.needsDraw = true;
  }

  addLayer(uri: string, file: DecodedLayer): void {
    this.sorter.addLayer(uri, this.renderer.addLayer(uri, file), file);
    if (!this.scene?.current) this.resort();
  }

  /** layers: URIs of the layers that live at the group. */
  addGroup(index: number, file: DecodedGroup, layers: string[]): void {
    this.sorter.addGroup(index, this.renderer.addGroup(index, file, layers), file, layers);
  }

  dropLayer(uri: string): void {
    this.renderer.dropLayer(uri);
    this.sorter.drop(uri);
    if (!this.scene?.current) this.resort();
  }

  dropGroup(index: number): void {
    this.renderer.dropGroup(index);
    this.sorter.drop(index);
  }

  /** True if the browser draws in software. */
  get software(): boolean {
    return this.renderer.software;
  }

  /** True after the graphics device was lost. */
  get lost(): boolean {
    return this.renderer.lost;
  }

  /** Number of points in the order that is drawn. */
  get points(): number {
    return this.renderer.points;
  }

  /** Sort and draw again, because the time, the camera or the size changed. */
  invalidate(): void {
    this.needsDraw = true;
    this.needsSort = true;
  }

  /** Sort again, because other points are shown, and draw once the order is here. */
  resort(): void {
    this.needsSort = true;
  }

  /** Draw the present order again, because only the resolution changed. */
  redraw(): void {
    this.needsDraw = true;
  }

  /** Groups on screen, or about to be with the next order. */
  get inUse(): number[] {
    return [this.scene, this.sorting]
      .flatMap((scene) => [scene?.current?.group, scene?.previous?.group])
      .filter((group) => group !== undefined);
  }

  /** True if a new order is needed and the worker is idle. */
  get wantsSort(): boolean {
    return this.needsSort && !this.sorter.busy;
  }

  /** Resolve when the worker is idle. */
  async settled(): Promise<void> {
    while (this.sorter.busy) await new Promise((resolve) => setTimeout(resolve, 1));
  }

  /** Sort a scene, which `draw` shows from then on. Resolves to false if the reel was closed or the scene partly dropped meanwhile. */
  async sort(scene: Scene, view: View): Promise<boolean> {
    this.needsSort = false;
    this.sorting = scene;
    const { manifest } = this.reel!;
    const { current, previous } = scene;
    const weight =
      current && previous
        ? weightAt(manifest, manifest.groups[current.group].firstFrame + current.frame, current.group)
        : 1;
    const reply = await this.sorter.sort(scene, view, manifest.clearance, weight);
    this.sorting = null;
    if (this.closed || !this.renderer.holds(scene)) return false;
    this.sortMilliseconds = reply.milliseconds;
    this.renderer.setOrder(reply.order, reply.count);
    this.sorter.recycle(reply.order);
    this.scene = scene;
    this.schedule = manifest;
    this.isOrderNew = true;
    this.sortedFor = view;
    this.needsDraw = true;
    return true;
  }

  /** Draw if anything changed. frame: of the video, null while its files are missing. eyes: views of a headset. */
  draw(frame: number | null, view: View, eyes: Eye[] | null = null): void {
    const { scene, schedule } = this;
    if (!this.needsDraw || !scene || !schedule) return;
    this.needsDraw = false;
    this.pictures++;
    // A view beyond the sorted frustum would lack points at its borders: the last covered view stays until the next order.
    const shownView = (this.view = eyes || this.isCovered(view) ? view : this.sortedFor!);
    const paint = (shown: Scene, weight: number): void =>
      eyes ? this.renderer.drawEyes(shown, weight, eyes) : this.renderer.draw(shown, weight, shownView);
    if (scene.current === null) return paint(scene, 1);
    const { groups } = schedule;
    const { group } = scene.current;
    // Keep drawing the last frame until the sort order for the new one arrives.
    const ordered = groups[group].firstFrame + scene.current.frame;
    if (frame !== null && isOrderedFor(scene, frame, schedule)) this.drawnFrame = frame;
    else if (frame !== null && frame < ordered && this.isOrderNew) this.drawnFrame = ordered; // time runs backwards: draw one frame behind
    this.isOrderNew = false;
    const [current, previous] = [scene.current, scene.previous].map(
      (shown) => shown && { group: shown.group, frame: clampFrame(groups[shown.group], this.drawnFrame) },
    );
    paint({ ...scene, current, previous }, previous ? weightAt(schedule, this.drawnFrame, group) : 1);
  }

  /** Return true if the order contains all points that a view sees beyond half of the distance to the scene's center. */
  private isCovered(view: View): boolean {
    const [low, high] = this.reel!.manifest.bounds;
    const distance = length(subtract(scale(add(low, high), 0.5), eyeOf(view.viewmat)));
    return this.sortedFor === null || covers(this.sortedFor, view, Math.max(distance / 2, view.near));
  }

  /** Sort and draw a scene at once, and read the pixels back. */
  async snapshot(scene: Scene, weight: number, view: View): Promise<Picture> {
    await this.settled();
    if (!(await this.sort(scene, view))) throw new Error("The reel was closed.");
    this.renderer.draw(scene, weight, view);
    return { width: view.width, height: view.height, data: this.renderer.readPixels() };
  }

  /** Return the depth at a pixel of the last frame at which a share of the light is absorbed, in world units; null if less is. */
  depthAt(x: number, y: number, share = 0.5): number | null {
    return this.renderer.depthAt(x, y, share);
  }

  /** Create the layer that a WebXR session shows. */
  createHeadsetLayer(session: object): Promise<HeadsetLayer> {
    return this.renderer.createHeadsetLayer(session);
  }

  destroy(): void {
    this.closed = true;
    this.sorter.destroy();
    this.renderer.destroy();
  }
}

/** Return true if an order fits a frame: it has all groups on screen, and was not sorted for a later frame, as when a group repeats. */
export function isOrderedFor({ current, previous }: Scene, frame: number, schedule: Schedule): boolean {
  if (current === null) return true;
  const group = schedule.groups[current.group];
  const holds =
    (frame >= group.firstFrame && frame <= group.firstFrame + group.frames - 1) ||
    groupAt(schedule, frame) === current.group;
  return (
    holds &&
    (previous !== null || weightAt(schedule, frame, current.group) === 1) &&
    clampFrame(group, frame) >= current.frame
  );
}
