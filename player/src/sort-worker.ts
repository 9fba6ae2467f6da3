/** Keeps the positions of every loaded file and answers with the far-to-near order of what shows. */
import { DepthSorter, type DepthAxis, type SortableGroup, type SortableLayer } from "./sort";
import { staticFlags, type Shown } from "./timeline";

/** What is drawn: how many layers, and which groups. Without a group, every point of the layers. */
export interface Scene {
  layers: number;
  current: Shown | null;
  previous: Shown | null;
}

export type SortMessage =
  | { type: "layer"; index: number; layer: SortableLayer }
  | { type: "group"; index: number; group: SortableGroup }
  | { type: "drop"; index: number }
  | { type: "sort"; scene: Scene; axis: DepthAxis; near: number; buffer: Uint32Array | null };

export interface SortReply {
  order: Uint32Array;
  count: number;
  milliseconds: number;
}

const scope = self as unknown as { onmessage: (event: MessageEvent<SortMessage>) => void; postMessage(message: SortReply, transfer: Transferable[]): void };
const layers: SortableLayer[] = [];
const groups = new Map<number, SortableGroup>();
const sorter = new DepthSorter();
/** The flags of the last scene: they change with the pair of groups only. */
let cached: { key: string; flags: Uint8Array } = { key: "", flags: new Uint8Array() };

scope.onmessage = ({ data }) => {
  if (data.type === "layer") layers[data.index] = data.layer;
  else if (data.type === "group") groups.set(data.index, data.group);
  else if (data.type === "drop") groups.delete(data.index);
  else {
    const began = performance.now();
    collect(data.scene, data.axis, data.near);
    const { order, count } = sorter.sort(data.buffer);
    scope.postMessage({ order, count, milliseconds: performance.now() - began }, [order.buffer]);
  }
};

function collect(scene: Scene, axis: DepthAxis, near: number): void {
  const shown = [scene.current, scene.previous].filter((item) => item !== null);
  const statics = layers.slice(0, scene.layers);
  const total = statics.reduce((sum, layer) => sum + layer.means.length / 3, 0);
  const moving = shown.reduce((sum, item) => sum + groups.get(item.group)!.means.length / 3, 0);
  sorter.reset(total + moving);
  const flags = scene.current ? flagsOf(scene, total) : null;
  let first = 0;
  for (const layer of statics) {
    const count = layer.means.length / 3;
    sorter.addLayer(layer, flags?.subarray(first, first + count) ?? null, axis, near);
    first += count;
  }
  for (const item of shown) sorter.addGroup(groups.get(item.group)!, item.frame, axis, near);
}

function flagsOf(scene: Scene, total: number): Uint8Array {
  const key = `${scene.layers} ${scene.current?.group} ${scene.previous?.group}`;
  if (cached.key !== key) {
    const before = scene.previous ? groups.get(scene.previous.group)!.alive : null;
    cached = { key, flags: staticFlags(total, groups.get(scene.current!.group)!.alive, before) };
  }
  return cached.flags;
}
