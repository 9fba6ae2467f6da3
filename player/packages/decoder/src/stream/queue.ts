/** Download queue, most urgent first: layers, then the current group, then those that follow, as far as memory allows. */
import type { Manifest } from "../reel/manifest";
import type { Page } from "../reel/pages";
import { layersAt, type ReelFile } from "../reel/reel-file";
import { firstFrameOf, missingPages, pageOf } from "../reel/timeline";

/** Seconds to buffer ahead, if memory allows. */
const AHEAD = 8;

/** What playback needs now. */
export interface Demand {
  /** Current group; null until its page is loaded. */
  current: number | null;
  /** Group that fades out; null outside of a cross-fade. */
  previous: number | null;
  /** Groups on screen. */
  inUse: number[];
  loop: boolean;
  frame: number;
  /** Playback rate. */
  rate: number;
}

/** A file to download. key: identifies its job. urgent: playback waits for it. */
export type QueueItem = { key: string; urgent: boolean } & (
  { kind: "layer"; file: ReelFile } | { kind: "group"; index: number; file: ReelFile } | { kind: "page"; file: Page }
);

/** Return the queue of a demand. budget: bytes of memory for groups and retired layers. costOf: returns the bytes of an item. */
export function queueOf(
  manifest: Manifest,
  { current, previous, frame, loop }: Demand,
  budget: number,
  costOf: (item: QueueItem) => number,
): QueueItem[] {
  const { first, groups, pages, layers, fps } = manifest;
  if (current === null) {
    const missing = missingPages(manifest, frame);
    // Permanent layers are needed whatever the page lists.
    const lasting = layers.filter(
      ({ group, until }) => until === Infinity && missing.some((page) => group <= page.group),
    );
    return [...missing.map((page) => pageItem(page, true)), ...lasting.map((layer) => layerItem(layer, true))];
  }
  const known = new Set<string>();
  const sum = (items: QueueItem[]): number => items.reduce((total, item) => total + costOf(item), 0);
  /** Return groups, preceded by their layers that are not in the queue yet. */
  const itemsOf = (urgent: boolean, ...numbers: number[]): QueueItem[] => {
    const needed = new Set(numbers.flatMap((number) => layersAt(groups[number])));
    const items = [
      ...[...needed].map((layer) => layerItem(layer, urgent)),
      ...numbers.map((number) => groupItem(number, groups[number], urgent)),
    ];
    return items.filter(({ key }) => !known.has(key) && known.add(key));
  };
  const result = itemsOf(true, current, ...(previous === null ? [] : [previous]));
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
    const files = itemsOf(false, index);
    room -= sum(files);
    // The next group is queued whatever the budget, since playback cannot go on without it.
    if (room < 0 && ahead > 1) break;
    result.push(...files);
    seconds += groups[index].frames / fps;
  }
  return result;
}

/** Return true if a group is on screen or needed now. */
export function isOnScreen(group: number, { current, previous, inUse }: Demand): boolean {
  return group === current || group === previous || inUse.includes(group);
}

/** Return the seconds until a group is shown. */
export function secondsTo(group: number, manifest: Manifest, { frame, rate, current }: Demand): number {
  const { groups, frames, first, fps } = manifest;
  const around = current !== null && group < current ? frames - firstFrameOf(manifest, first)! : 0;
  return (groups[group].firstFrame + around - frame) / fps / Math.max(rate, 0.1);
}

/** Return the key of a group. */
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
