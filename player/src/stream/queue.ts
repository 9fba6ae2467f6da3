/** What should be here, the most urgent first: the layers, then the group that shows, then those that follow, as far as memory goes. */
import type { Manifest } from "../reel/manifest";

/** Seconds to have ahead of the time that shows, if memory allows. */
const AHEAD = 8;

/** What shows: the group, the one that fades out, the groups still on screen; whether the first follows the last; the frame and its rate. */
export interface Demand {
  current: number;
  previous: number | null;
  inUse: number[];
  loop: boolean;
  frame: number;
  rate: number;
}

/** A file of the reel. key: its name among those being got. */
export interface QueueItem {
  kind: "layer" | "group";
  index: number;
  key: string;
}

/** budget: bytes that groups may take. costOf: bytes that a group takes. */
export function queueOf(manifest: Manifest, { current, previous, loop }: Demand, budget: number, costOf: (group: number) => number): QueueItem[] {
  const { groups, fps } = manifest;
  const layers = (from: number, to: number): QueueItem[] =>
    manifest.layers.flatMap((layer, index) => (layer.group >= from && layer.group <= to ? [layerItem(index)] : []));
  const result = [...layers(0, current), groupItem(current)];
  if (previous !== null) result.push(groupItem(previous));
  let room = budget - costOf(current) - (previous === null ? 0 : costOf(previous));
  let seconds = 0;
  for (let ahead = 1; ahead < groups.length && seconds < AHEAD; ahead++) {
    if (current + ahead >= groups.length && !loop) break;
    const index = (current + ahead) % groups.length;
    if (index === previous) continue;
    room -= costOf(index);
    // The next group is wanted however little memory there is: nothing would play without it.
    if (room < 0 && ahead > 1) break;
    result.push(...layers(current + 1, index), groupItem(index));
    seconds += groups[index].frames / fps;
  }
  return result;
}

/** Whether an item is part of the picture that shows. */
export function isNeededNow({ kind, index }: QueueItem, manifest: Manifest, { current, previous }: Demand): boolean {
  return kind === "layer" ? manifest.layers[index].group <= current : index === current || index === previous;
}

/** Whether a group is on screen, or will be with the next picture. */
export function isOnScreen(group: number, { current, previous, inUse }: Demand): boolean {
  return group === current || group === previous || inUse.includes(group);
}

/** Seconds until a group shows. */
export function secondsTo(group: number, { groups, frames, fps }: Manifest, { frame, rate, current }: Demand): number {
  const around = group < current ? frames : 0;
  return (groups[group].firstFrame + around - frame) / fps / Math.max(rate, 0.1);
}

export function layerItem(index: number): QueueItem {
  return { kind: "layer", index, key: `layer ${index}` };
}

export function groupItem(index: number): QueueItem {
  return { kind: "group", index, key: `group ${index}` };
}

export function itemOf(key: string): QueueItem {
  const [kind, index] = key.split(" ");
  return kind === "layer" ? layerItem(Number(index)) : groupItem(Number(index));
}
