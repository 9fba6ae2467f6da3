/** The groups shown at a time, by the rules of "Showing time t" in docs/format.md. */

/** A range of frames. */
export interface Span {
  firstFrame: number;
  frames: number;
  /** Frames over which a group cross-fades with the one before; the schedule's if absent. */
  overlap?: number;
}

/** The `count` groups of a page, from number `group` on. */
export interface PageSpan extends Span {
  group: number;
  count: number;
}

/** The groups of a manifest over time. */
export interface Schedule {
  /** Number of the first group. Those before it were dropped or never existed. */
  first: number;
  /** Groups by number. Those of pages that are not loaded are missing. */
  groups: Span[];
  /** Pages in order of time. The manifest lists all groups after them. */
  pages: PageSpan[];
  overlap: number;
}

/** A group and the frame to show of it, clamped to its own frames. */
export interface Shown {
  group: number;
  frame: number;
}

/** The groups shown at a time. */
export interface Moment {
  current: Shown;
  /** The group that fades out; null outside of a cross-fade. */
  previous: Shown | null;
  /** Weight of the current group, 0 to 1. */
  weight: number;
}

/** Return the last group that begins at or before `frame`, or the first group. In a page that is not loaded, return its first group. */
export function groupAt({ first, groups, pages }: Schedule, frame: number): number {
  const page = pages.findLast(({ firstFrame }) => firstFrame <= frame) ?? pages[0];
  const last = pages.at(-1);
  let low = last ? last.group + last.count : first;
  let high = groups.length - 1;
  if (page && frame < groups[low].firstFrame) {
    if (!groups[page.group]) return page.group;
    [low, high] = [page.group, page.group + page.count - 1];
  }
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (groups[middle].firstFrame <= frame) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the first frame of a group; undefined in a page that is not loaded, except for its first group. */
export function firstFrameOf({ groups, pages }: Schedule, group: number): number | undefined {
  return (groups[group] ?? pages.find((page) => page.group === group))?.firstFrame;
}

/** Return the frames over which a group cross-fades with the one before, 0 for a hard cut. */
export function overlapOf({ groups, overlap }: Schedule, group: number): number {
  return groups[group]?.overlap ?? overlap;
}

/** Return the moment at `seconds`; null if its page is not loaded. */
export function momentAt(schedule: Schedule, fps: number, seconds: number): Moment | null {
  const { groups } = schedule;
  const frame = seconds * fps;
  if (missingPages(schedule, frame).length > 0) return null;
  const group = groupAt(schedule, frame);
  const weight = weightAt(schedule, frame, group);
  return {
    current: { group, frame: clampFrame(groups[group], frame) },
    previous: weight < 1 ? { group: group - 1, frame: clampFrame(groups[group - 1], frame) } : null,
    weight,
  };
}

/** Return the pages that must be loaded for a frame: that of its group, and that of the group that fades out. */
export function missingPages<P extends PageSpan>(schedule: Schedule & { pages: P[] }, frame: number): P[] {
  const group = groupAt(schedule, frame);
  const fading = group > schedule.first && frame - firstFrameOf(schedule, group)! < overlapOf(schedule, group);
  return (fading ? [group, group - 1] : [group])
    .filter((number) => !schedule.groups[number])
    .map((number) => pageOf(schedule.pages, number)!);
}

/** Return the page of a group. */
export function pageOf<P extends PageSpan>(pages: P[], number: number): P | undefined {
  return pages.find(({ group, count }) => group <= number && number < group + count);
}

/** Return the weight of a group at a frame, 0 to 1, if it were the current one. */
export function weightAt(schedule: Schedule, frame: number, group: number): number {
  const { first, groups } = schedule;
  const overlap = overlapOf(schedule, group);
  const share =
    overlap > 0 && group > first ? Math.min(Math.max((frame - groups[group].firstFrame) / overlap, 0), 1) : 1;
  return share * share * (3 - 2 * share);
}

/** Return the frame within a group for a frame of the video, clamped to the group. */
export function clampFrame(group: Span, frame: number): number {
  return Math.min(Math.max(frame - group.firstFrame, 0), Math.max(group.frames - 1, 0));
}

export const ALIVE_NOW = 1;
export const ALIVE_BEFORE = 2;

/** Flags of the static points that a group shows, over the layers in `layers`. */
export interface Alive {
  alive: Uint8Array;
  layers: string[];
}

/**
 * Return by layer which points are alive in a group and in the one before it, as bits ALIVE_NOW and ALIVE_BEFORE. counts: points per
 * layer. Points beyond the end of `alive` are not alive. Without a previous group (null) both bits are equal, so that nothing fades.
 * Without any group all points are alive.
 */
export function staticFlags(
  counts: Map<string, number>,
  now: Alive | null,
  before: Alive | null,
): Map<string, Uint8Array> {
  const flags = new Map(
    [...counts].map(([layer, count]) => [layer, new Uint8Array(count).fill(now ? 0 : ALIVE_NOW | ALIVE_BEFORE)]),
  );
  const mark = ({ alive, layers }: Alive, bit: number): void => {
    let first = 0;
    for (const layer of layers) {
      const own = flags.get(layer);
      if (!own) return; // the offset of the next layer is unknown
      for (let i = 0; i < Math.min(own.length, alive.length - first); i++) own[i] |= alive[first + i] * bit;
      first += own.length;
    }
  };
  if (now) {
    mark(now, ALIVE_NOW);
    mark(before ?? now, ALIVE_BEFORE);
  }
  return flags;
}

/** Return the weights of static points, indexed by their flags 0 to 3. */
export function staticWeights(weight: number): [number, number, number, number] {
  return [0, weight, 1 - weight, 1];
}
