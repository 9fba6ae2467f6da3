/** Keeps the positions of every loaded file and answers with the far-to-near order of what is in view. */
import { staticFlags } from "../reel/timeline";
import type { Frustum } from "./frustum";
import type { Scene } from "./scene";
import { DepthRun, merge, type SortableGroup, type SortableLayer } from "./sort";

export type SortMessage =
  | { type: "layer"; index: number; layer: SortableLayer }
  | { type: "group"; index: number; group: SortableGroup }
  | { type: "drop"; index: number }
  | { type: "sort"; scene: Scene; view: Frustum; buffer: Uint32Array | null };

export interface SortReply {
  order: Uint32Array;
  count: number;
  milliseconds: number;
}

const scope = self as unknown as { onmessage: (event: MessageEvent<SortMessage>) => void; postMessage(message: SortReply, transfer: Transferable[]): void };
const layers: SortableLayer[] = [];
const groups = new Map<number, SortableGroup>();
const still = new DepthRun();
const moving = new DepthRun();
/** What the static points were sorted for: while only time goes on, their order stays. */
let stillKey = "";
/** The flags of the last scene: they change with the pair of groups only. */
let cached: { key: string; flags: Uint8Array } = { key: "", flags: new Uint8Array() };

scope.onmessage = ({ data }) => {
  if (data.type === "layer") layers[data.index] = data.layer;
  else if (data.type === "group") groups.set(data.index, data.group);
  else if (data.type === "drop") groups.delete(data.index);
  else {
    const began = performance.now();
    sortStill(data.scene, data.view);
    sortMoving(data.scene, data.view);
    const { order, count } = merge(still, moving, data.buffer);
    scope.postMessage({ order, count, milliseconds: performance.now() - began }, [order.buffer]);
  }
};

function sortStill(scene: Scene, view: Frustum): void {
  const key = `${sceneKey(scene)} ${Object.values(view)}`;
  if (key === stillKey) return;
  stillKey = key;
  const statics = layers.slice(0, scene.layers);
  const total = statics.reduce((sum, layer) => sum + layer.means.length / 3, 0);
  const flags = scene.current ? flagsOf(scene, total) : null;
  still.reset(total);
  let first = 0;
  for (const layer of statics) {
    const count = layer.means.length / 3;
    still.addLayer(layer, flags?.subarray(first, first + count) ?? null, view);
    first += count;
  }
  still.sort();
}

function sortMoving(scene: Scene, view: Frustum): void {
  const shown = [scene.current, scene.previous].filter((item) => item !== null);
  moving.reset(shown.reduce((sum, item) => sum + groups.get(item.group)!.means.length / 3, 0));
  for (const item of shown) moving.addGroup(groups.get(item.group)!, item.frame, view);
  moving.sort();
}

function sceneKey(scene: Scene): string {
  return `${scene.layers} ${scene.current?.group} ${scene.previous?.group}`;
}

function flagsOf(scene: Scene, total: number): Uint8Array {
  const key = sceneKey(scene);
  if (cached.key !== key) {
    const before = scene.previous ? groups.get(scene.previous.group)!.alive : null;
    cached = { key, flags: staticFlags(total, groups.get(scene.current!.group)!.alive, before) };
  }
  return cached.flags;
}
