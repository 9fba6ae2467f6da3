/** What is on screen: one scene, sorted by the worker and drawn by the GPU. The picture always belongs to the order it is drawn in. */
import { add, eyeOf, length, scale, subtract } from "../base/matrix";
import type { View } from "../base/view";
import type { DecodedFile } from "../decode/decode-file";
import type { Manifest } from "../reel/manifest";
import { clampFrame, groupAt, weightAt, type Schedule } from "../reel/timeline";
import type { Eye } from "./eye";
import { covers } from "./frustum";
import { Renderer } from "./renderer";
import type { Scene } from "./scene";
import { Sorter } from "./sorter";

/** A picture taken: RGBA bytes, top row first. */
export interface Picture {
  width: number;
  height: number;
  data: Uint8Array;
}

export class Stage {
  /** The scene of the order on the GPU. */
  scene: Scene | null = null;
  /** Duration of the last sort, milliseconds. */
  sortMilliseconds = 0;
  /** Pictures drawn so far. */
  pictures = 0;
  /** Of the last one. */
  view: View | null = null;

  private readonly renderer: Renderer;
  private readonly sorter: Sorter;
  private drawnFrame = 0;
  private sortedFor: View | null = null;
  private needsSort = true;
  /** The order has not been drawn yet. */
  private isOrderNew = false;
  private needsDraw = false;
  private closed = false;
  private sorting: Scene | null = null;
  private manifest: Manifest | null = null;
  /** When the order was made: of a live reel, what shows then may be dropped from the next one. */
  private schedule: Schedule | null = null;

  constructor(canvas: HTMLCanvasElement, onError: (error: Error) => void) {
    this.renderer = new Renderer(canvas);
    this.sorter = new Sorter((message) => onError(new Error(message)));
  }

  /** Once its manifest is here; the graphics device and the worker get ready before. Throws `ReelError` where the device cannot draw. */
  open(manifest: Manifest): void {
    this.manifest = manifest;
    this.renderer.begin(manifest.antialias === true, manifest.background ?? [0, 0, 0]);
  }

  /** A live reel has grown, or more is known of one. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
  }

  addLayer(uri: string, file: DecodedFile): void {
    this.sorter.addLayer(uri, this.renderer.memory.addLayer(uri, file), file);
    if (!this.scene?.current) this.resort();
  }

  /** layers: the uris of those that live at the group. */
  addGroup(index: number, file: DecodedFile, layers: string[]): void {
    this.sorter.addGroup(index, this.renderer.memory.addGroup(index, file, layers), file, layers);
  }

  dropLayer(uri: string): void {
    this.renderer.memory.dropLayer(uri);
    this.sorter.drop(uri);
    if (!this.scene?.current) this.resort();
  }

  dropGroup(index: number): void {
    this.renderer.memory.dropGroup(index);
    this.sorter.drop(index);
  }

  /** Pictures are drawn without a graphics device. */
  get software(): boolean {
    return this.renderer.software;
  }

  /** The graphics device is gone. */
  get lost(): boolean {
    return this.renderer.lost;
  }

  /** Points in the order that is drawn. */
  get points(): number {
    return this.renderer.points;
  }

  /** The time, the camera or the size changed: sort and draw again. */
  invalidate(): void {
    this.needsDraw = true;
    this.needsSort = true;
  }

  /** Other points are to be shown: sort, and draw once that is done. */
  resort(): void {
    this.needsSort = true;
  }

  /** Draw again what is sorted: only the number of pixels changed. */
  redraw(): void {
    this.needsDraw = true;
  }

  /** Groups that are on screen, or will be with the next order. */
  get inUse(): number[] {
    return [this.scene, this.sorting].flatMap((scene) => [scene?.current?.group, scene?.previous?.group]).filter((group) => group !== undefined);
  }

  /** A sort would bring something new, and the worker has time for it. */
  get wantsSort(): boolean {
    return this.needsSort && !this.sorter.busy;
  }

  /** Resolves when the worker is idle. */
  async settled(): Promise<void> {
    while (this.sorter.busy) await new Promise((resolve) => setTimeout(resolve, 1));
  }

  /** Sort a scene, which then is what is drawn. False if the reel was closed or some of it dropped while the worker was at it. */
  async sort(scene: Scene, view: View): Promise<boolean> {
    this.needsSort = false;
    this.sorting = scene;
    const manifest = this.manifest!;
    const reply = await this.sorter.sort(scene, view, manifest.clearance);
    this.sorting = null;
    if (this.closed || !this.renderer.memory.holds(scene)) return false;
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

  /** Draw, if anything changed. `frame` of the video: the present one, or null while what belongs to it is not here. Eyes: of a headset. */
  draw(frame: number | null, view: View, eyes: Eye[] | null = null): void {
    const { scene, schedule } = this;
    if (!this.needsDraw || !scene || !schedule) return;
    this.needsDraw = false;
    this.pictures++;
    // Where the view leaves what it was sorted for, the picture is one behind rather than cut off.
    const shownView = (this.view = eyes || this.isCovered(view) ? view : this.sortedFor!);
    const paint = (shown: Scene, weight: number): void => (eyes ? this.renderer.drawEyes(shown, weight, eyes) : this.renderer.draw(shown, weight, shownView));
    if (scene.current === null) return paint(scene, 1);
    const { groups } = schedule;
    const { group } = scene.current;
    // A moment that the order is not for waits for its own; until then the last one stays.
    const ordered = groups[group].firstFrame + scene.current.frame;
    if (frame !== null && isOrderedFor(scene, frame, schedule)) this.drawnFrame = frame;
    else if (frame !== null && frame < ordered && this.isOrderNew) this.drawnFrame = ordered; // time runs backwards: one behind
    this.isOrderNew = false;
    const [current, previous] = [scene.current, scene.previous].map((shown) => shown && { group: shown.group, frame: clampFrame(groups[shown.group], this.drawnFrame) });
    paint({ ...scene, current, previous }, previous ? weightAt(schedule, this.drawnFrame, group) : 1);
  }

  /** Whether all that a view sees is in the order, at half the way to the scene's middle and beyond. */
  private isCovered(view: View): boolean {
    const [low, high] = this.manifest!.bounds;
    const way = length(subtract(scale(add(low, high), 0.5), eyeOf(view.viewmat)));
    return this.sortedFor === null || covers(this.sortedFor, view, Math.max(way / 2, view.near));
  }

  /** Sort and draw a scene at once, and read the picture back. */
  async snapshot(scene: Scene, weight: number, view: View): Promise<Picture> {
    await this.settled();
    if (!(await this.sort(scene, view))) throw new Error("The reel was closed.");
    this.renderer.draw(scene, weight, view);
    return { width: view.width, height: view.height, data: this.renderer.readPixels() };
  }

  /** Depth of what is seen at a pixel of the last picture, world units; null where there is nothing. */
  depthAt(x: number, y: number): number | null {
    return this.renderer.depthAt(x, y);
  }

  destroy(): void {
    this.closed = true;
    this.sorter.destroy();
    this.renderer.destroy();
  }
}

/** Whether an order serves for a frame: with all groups that show, and from no later frame, as where time begins again within a group. */
export function isOrderedFor({ current, previous }: Scene, frame: number, schedule: Schedule): boolean {
  if (current === null) return true;
  const group = schedule.groups[current.group];
  const holds = (frame >= group.firstFrame && frame <= group.firstFrame + group.frames - 1) || groupAt(schedule, frame) === current.group;
  return holds && (previous !== null || weightAt(schedule, frame, current.group) === 1) && clampFrame(group, frame) >= current.frame;
}
