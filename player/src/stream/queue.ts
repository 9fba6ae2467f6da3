/** What should be here, the most urgent first: the layers, then the group that shows, then those that follow, as far as memory goes. */
import type { Manifest } from "../reel/manifest";
import type { Page } from "../reel/pages";
import { layersAt, type ReelFile } from "../reel/reel-file";
import { firstFrameOf, missingPages, pageOf } from "../reel/timeline";

/** Seconds to have ahead of the time that shows, if memory allows. */
const AHEAD = 8;

/** What shows: the group, null where its page is not here; the one that fades out; the groups still on screen; whether the first follows the last; the frame and its rate. */
export interface Demand {
  current: number | null;
  previous: number | null;
  inUse: number[];
  loop: boolean;
  frame: number;
  rate: number;
}

/** A file of the reel. key: its name among those being got. urgent: it is part of the picture that shows. */
export type QueueItem = { key: string; urgent: boolean } & (
  | { kind: "layer"; file: ReelFile }
  | { kind: "group"; index: number; file: ReelFile }
  | { kind: "page"; file: Page }
);

/** budget: bytes that groups may take, and layers that are retired again. costOf: bytes that one takes. */
export function queueOf(manifest: Manifest, { current, previous, frame, loop }: Demand, budget: number, costOf: (item: QueueItem) => number): QueueItem[] {
  const { first, groups, pages, layers, fps } = manifest;
  if (current === null) {
    const missing = missingPages(manifest, frame);
    // What is never retired is needed whatever the page says.
    const lasting = layers.filter(({ group, until }) => until === Infinity && missing.some((page) => group <= page.group));
    return [...missing.map((page) => pageItem(page, true)), ...lasting.map((layer) => layerItem(layer, true))];
  }
  const known = new Set<string>();
  const sum = (items: QueueItem[]): number => items.reduce((total, item) => total + costOf(item), 0);
  /** Groups, after those of their layers that are not in the queue yet. */
  const filesOf = (urgent: boolean, ...numbers: number[]): QueueItem[] => {
    const needed = new Set(numbers.flatMap((number) => layersAt(groups[number])));
    const items = [...[...needed].map((layer) => layerItem(layer, urgent)), ...numbers.map((number) => groupItem(number, groups[number], urgent))];
    return items.filter(({ key }) => !known.has(key) && known.add(key));
  };
  const result = filesOf(true, current, ...(previous === null ? [] : [previous]));
  let room = budget - sum(result);
  let seconds = 0;
  const count = groups.length - first;
  for (let ahead = 1; ahead < count && seconds < AHEAD; ahead++) {
    if (current + ahead >= groups.length && !loop) break;
    const index = first + ((current - first + ahead) % count);
    if (index === previous) continue;
    if (!groups[index]) {
      result.push(pageItem(pageOf(pages, index)!, false));
      break;
    }
    const files = filesOf(false, index);
    room -= sum(files);
    // The next group is wanted however little memory there is: nothing would play without it.
    if (room < 0 && ahead > 1) break;
    result.push(...files);
    seconds += groups[index].frames / fps;
  }
  return result;
}

/** Whether a group is on screen, or will be with the next picture. */
export function isOnScreen(group: number, { current, previous, inUse }: Demand): boolean {
  return group === current || group === previous || inUse.includes(group);
}

/** Seconds until a group shows. */
export function secondsTo(group: number, manifest: Manifest, { frame, rate, current }: Demand): number {
  const { groups, frames, first, fps } = manifest;
  const around = current !== null && group < current ? frames - firstFrameOf(manifest, first)! : 0;
  return (groups[group].firstFrame + around - frame) / fps / Math.max(rate, 0.1);
}

export function groupKey(number: number): string {
  return `group ${number}`;
}

function groupItem(index: number, file: ReelFile, urgent: boolean): QueueItem {
  return { kind: "group", index, file, urgent, key: groupKey(index) };
}

function layerItem(file: ReelFile, urgent: boolean): QueueItem {
  return { kind: "layer", file, urgent, key: `layer ${file.uri}` };
}

function pageItem(file: Page, urgent: boolean): QueueItem {
  return { kind: "page", file, urgent, key: `page ${file.uri}` };
}
