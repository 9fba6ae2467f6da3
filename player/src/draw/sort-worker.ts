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
const statics = new DepthRun();
const dynamics = new DepthRun();
/** What the static points were sorted for: while only time goes on, their order stays. */
let staticsKey = "";
/** The flags of the last scene: they change with the pair of groups only. */
let cached: { key: string; flags: Uint8Array } = { key: "", flags: new Uint8Array() };

scope.onmessage = ({ data }) => {
  if (data.type === "layer") layers[data.index] = data.layer;
  else if (data.type === "group") groups.set(data.index, data.group);
  else if (data.type === "drop") groups.delete(data.index);
  else {
    const began = performance.now();
    sortStatics(data.scene, data.view);
    sortDynamics(data.scene, data.view);
    const { order, count } = merge(statics, dynamics, data.buffer);
    scope.postMessage({ order, count, milliseconds: performance.now() - began }, [order.buffer]);
  }
};

function sortStatics(scene: Scene, view: Frustum): void {
  const key = `${sceneKey(scene)} ${Object.values(view)}`;
  if (key === staticsKey) return;
  staticsKey = key;
  const shownLayers = layers.slice(0, scene.layers);
  const total = shownLayers.reduce((sum, layer) => sum + layer.means.length / 3, 0);
  const flags = scene.current ? flagsOf(scene, total) : null;
  statics.reset(total);
  let first = 0;
  for (const layer of shownLayers) {
    const count = layer.means.length / 3;
    statics.addLayer(layer, flags?.subarray(first, first + count) ?? null, view);
    first += count;
  }
  statics.sort();
}

function sortDynamics(scene: Scene, view: Frustum): void {
  const shown = [scene.current, scene.previous].filter((item) => item !== null);
  dynamics.reset(shown.reduce((sum, item) => sum + groups.get(item.group)!.means.length / 3, 0));
  for (const item of shown) dynamics.addGroup(groups.get(item.group)!, item.frame, view);
  dynamics.sort();
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
