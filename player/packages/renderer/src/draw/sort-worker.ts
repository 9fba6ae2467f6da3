/** Worker that keeps the positions of all loaded files and sorts the visible points far to near. */
import { type Alive, staticFlags } from "@splatreel/decoder/internal";
import type { Frustum } from "./frustum";
import type { Scene } from "./scene";
import { DepthRun, merge, type SortableGroup, type SortableLayer } from "./sort";

/** Message to the sort worker. */
export type SortMessage =
  | { type: "layer"; uri: string; layer: SortableLayer }
  | { type: "group"; index: number; group: SortableGroup & Alive }
  | { type: "drop"; name: string | number }
  | { type: "sort"; scene: Scene; view: Frustum; buffer: Uint32Array | null };

/** Reply of the sort worker. */
export interface SortReply {
  order: Uint32Array;
  count: number;
  milliseconds: number;
}

const scope = self as unknown as {
  onmessage: (event: MessageEvent<SortMessage>) => void;
  postMessage(message: SortReply, transfer: Transferable[]): void;
};
/** Layers by URI, groups by number. */
const layers = new Map<string, SortableLayer>();
const groups = new Map<number, SortableGroup & Alive>();
const statics = new DepthRun();
const dynamics = new DepthRun();
/** Scene and view of the sorted static points. Their order stays valid while only time passes. */
let staticsKey = "";
/** Flags of the last scene. They change only with the pair of groups. */
let cached: { key: string; flags: Map<string, Uint8Array> } = { key: "", flags: new Map() };

scope.onmessage = ({ data }) => {
  if (data.type === "layer") layers.set(data.uri, data.layer);
  else if (data.type === "group") groups.set(data.index, data.group);
  else if (data.type === "drop") layers.delete(data.name as string) || groups.delete(data.name as number);
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
  const flags = flagsOf(scene);
  statics.reset([...flags.values()].reduce((sum, { length }) => sum + length, 0));
  for (const [uri, own] of flags) if (own.length > 0) statics.addLayer(layers.get(uri)!, own, view);
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

function flagsOf(scene: Scene): Map<string, Uint8Array> {
  const key = sceneKey(scene);
  if (cached.key !== key) {
    const counts = new Map(scene.layers.map((uri) => [uri, (layers.get(uri)?.means.length ?? 0) / 3]));
    const [now, before] = [scene.current, scene.previous].map((shown) => shown && groups.get(shown.group)!);
    cached = { key, flags: staticFlags(counts, now, before) };
  }
  return cached.flags;
}
