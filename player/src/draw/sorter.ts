/** The page's side of the sort worker: one request at a time, buffers handed back and forth. */
import type { View } from "../base/view";
import type { DecodedFile } from "../decode/decode-file";
import type { Gaussians } from "../decode/gaussians";
import { startSortWorker } from "../files/bundle";
import { failureOf } from "../files/workers";
import type { Clearance } from "../reel/manifest";
import { EXTENT, frustumOf } from "./frustum";
import type { Scene } from "./scene";
import type { SortMessage, SortReply } from "./sort-worker";

export class Sorter {
  private readonly worker = startSortWorker();
  private waiting: ((reply: SortReply) => void) | null = null;
  private spare: Uint32Array | null = null;

  constructor(onError: (message: string) => void) {
    this.worker.onmessage = ({ data }: MessageEvent<SortReply>) => {
      const resolve = this.waiting;
      this.waiting = null;
      resolve?.(data);
    };
    this.worker.onerror = (event) => onError(`Sorting failed (${failureOf(event)}).`);
  }

  get busy(): boolean {
    return this.waiting !== null;
  }

  /** Hand over a layer's positions; base is its first point in the draw order. */
  addLayer(uri: string, base: number, file: DecodedFile): void {
    const { means } = file.points;
    const radii = radiiOf(file.points);
    this.post({ type: "layer", uri, layer: { base, means, radii } }, [means.buffer, radii.buffer] as ArrayBuffer[]);
  }

  /** Hand over a group's positions and offsets, which leave this thread; what is alive in it, of these layers, is copied. */
  addGroup(index: number, base: number, file: DecodedFile, layers: string[]): void {
    const { means } = file.points;
    const { dx, dxMin, dxStep, frames } = file.offsets ?? { dx: new Uint16Array(), dxMin: [0, 0, 0], dxStep: [0, 0, 0], frames: 1 };
    const radii = radiiOf(file.points);
    const group = { base, means, radii, frames, dx, dxMin, dxStep, alive: file.alive, layers };
    this.post({ type: "group", index, group }, [means.buffer, radii.buffer, dx.buffer] as ArrayBuffer[]);
  }

  /** Forget a layer, by its uri, or a group. */
  drop(what: string | number): void {
    this.post({ type: "drop", what });
  }

  /** The far-to-near order of what a view sees of a scene, with this room before it. Only while not busy; give the order back with `recycle`. */
  sort(scene: Scene, view: View, clearance: Clearance): Promise<SortReply> {
    const buffer = this.spare;
    this.spare = null;
    return new Promise((resolve) => {
      this.waiting = resolve;
      this.post({ type: "sort", scene, view: frustumOf(view, clearance), buffer }, buffer ? [buffer.buffer as ArrayBuffer] : []);
    });
  }

  recycle(order: Uint32Array): void {
    this.spare = order;
  }

  destroy(): void {
    this.worker.terminate();
  }

  private post(message: SortMessage, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }
}

/** How far splats reach, world units: as if all were opaque, which a change of opacity may make them. */
function radiiOf({ scales, count }: Gaussians): Float32Array<ArrayBuffer> {
  const radii = new Float32Array(count);
  for (let i = 0; i < count; i++) radii[i] = EXTENT * Math.max(scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]);
  return radii;
}
