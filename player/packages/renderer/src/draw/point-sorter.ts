/** Interface between the stage and what sorts points: a worker, or the engine of a scene. */
import type { View } from "../base/view";
import type { Clearance, DecodedGroup, DecodedLayer } from "@splatreel/decoder/internal";
import type { Scene } from "./scene";
import type { SortReply } from "./sort-worker";

/** Sorts the points of a reel, one request at a time. */
export interface PointSorter {
  readonly busy: boolean;
  /** Take the positions of a layer. base: index of its first point in the draw order. */
  addLayer(uri: string, base: number, file: DecodedLayer): void;
  /** Take the positions and offsets of a group. layers: URIs of the layers that its `alive` flags cover. */
  addGroup(index: number, base: number, file: DecodedGroup, layers: string[]): void;
  /** Forget a layer, by its URI, or a group, by its number. */
  drop(name: string | number): void;
  /**
   * Sort the points of a scene that a view sees, far to near. Requires that it is not busy; return the order with `recycle`.
   * weight: of the current group in a cross-fade.
   */
  sort(scene: Scene, view: View, clearance: Clearance, weight: number): Promise<SortReply>;
  recycle(order: Uint32Array): void;
  destroy(): void;
}
