/** Main-thread side of the sort worker. It sends one request at a time and reuses the buffers. */
import type { View } from "../base/view";
import {
  type Clearance,
  type DecodedGroup,
  type DecodedLayer,
  failureOf,
  type Gaussians,
} from "@splatreel/decoder/internal";
import { startSortWorker } from "../files/bundle";
import { EXTENT, frustumOf } from "./frustum";
import type { Scene } from "./scene";
import type { PointSorter } from "./point-sorter";
import type { SortMessage, SortReply } from "./sort-worker";

/** Sends positions and sort requests to the worker. */
export class Sorter implements PointSorter {
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

  /** Transfer the positions of a layer. base: index of its first point in the draw order. */
  addLayer(uri: string, base: number, file: DecodedLayer): void {
    const { means } = file.points;
    const radii = radiiOf(file.points);
    this.post({ type: "layer", uri, layer: { base, means, radii } }, [means.buffer, radii.buffer] as ArrayBuffer[]);
  }

  /** Transfer the positions and offsets of a group, and copy its `alive` flags. layers: URIs of the layers that these flags cover. */
  addGroup(index: number, base: number, file: DecodedGroup, layers: string[]): void {
    const { means } = file.points;
    const { dx, dxMin, dxStep, frames } = file.offsets ?? {
      dx: new Uint16Array(),
      dxMin: [0, 0, 0],
      dxStep: [0, 0, 0],
      frames: 1,
    };
    const radii = radiiOf(file.points);
    const group = { base, means, radii, frames, dx, dxMin, dxStep, alive: file.alive, layers };
    this.post({ type: "group", index, group }, [means.buffer, radii.buffer, dx.buffer] as ArrayBuffer[]);
  }

  /** Forget a layer, by its URI, or a group, by its number. */
  drop(name: string | number): void {
    this.post({ type: "drop", name });
  }

  /** Request the far-to-near order of the points that a view sees. Requires an idle worker; return the buffer with `recycle`. */
  sort(scene: Scene, view: View, clearance: Clearance): Promise<SortReply> {
    const buffer = this.spare;
    this.spare = null;
    return new Promise((resolve) => {
      this.waiting = resolve;
      this.post(
        { type: "sort", scene, view: frustumOf(view, clearance), buffer },
        buffer ? [buffer.buffer as ArrayBuffer] : [],
      );
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

/** Return the radius of each splat in world units, for full opacity, since the opacity may change over time. */
function radiiOf({ scales, count }: Gaussians): Float32Array<ArrayBuffer> {
  const radii = new Float32Array(count);
  for (let i = 0; i < count; i++) radii[i] = EXTENT * Math.max(scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]);
  return radii;
}
