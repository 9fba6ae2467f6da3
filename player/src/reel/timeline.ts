/** What is shown at time t: the rules of "Showing time t" in docs/format.md. */

export interface Span {
  firstFrame: number;
  frames: number;
}

/** So many groups, from the one of number `group` on, which are listed in a file of their own. */
export interface PageSpan extends Span {
  group: number;
  count: number;
}

/** Which groups show when: of a manifest. */
export interface Schedule {
  /** The number of the first group: those before it were dropped, or never were. */
  first: number;
  /** By their numbers; those of a page that is not here are missing. */
  groups: Span[];
  /** In order of time; the groups after them are all here. */
  pages: PageSpan[];
  overlap: number;
}

/** A group and the frame within it, clamped to its own frames. */
export interface Shown {
  group: number;
  frame: number;
}

export interface Moment {
  current: Shown;
  /** The group that fades out, if one does. */
  previous: Shown | null;
  /** Weight of what is new in the current group, 0..1. */
  weight: number;
}

/** The last group whose first frame is at most `frame` (the first group for earlier times); in a page that is not here, its first. */
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

/** A group's first frame, where that is known: pages say it of their first. */
export function firstFrameOf({ groups, pages }: Schedule, group: number): number | undefined {
  return (groups[group] ?? pages.find((page) => page.group === group))?.firstFrame;
}

/** The moment at `seconds`; null: a page that says so is not here. */
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

/** The pages that are not here and say what shows at a frame: of its group, and of the one before it while that fades out. */
export function missingPages<P extends PageSpan>(schedule: Schedule & { pages: P[] }, frame: number): P[] {
  const group = groupAt(schedule, frame);
  const fading = group > schedule.first && frame - firstFrameOf(schedule, group)! < schedule.overlap;
  return (fading ? [group, group - 1] : [group]).filter((number) => !schedule.groups[number]).map((number) => pageOf(schedule.pages, number)!);
}

/** The page that a group is in. */
export function pageOf<P extends PageSpan>(pages: P[], number: number): P | undefined {
  return pages.find(({ group, count }) => group <= number && number < group + count);
}

/** Weight of what is new in a group, 0..1, if it is taken as the current one, whether or not its time has come. */
export function weightAt({ first, groups, overlap }: Schedule, frame: number, group: number): number {
  const share = overlap > 0 && group > first ? Math.min(Math.max((frame - groups[group].firstFrame) / overlap, 0), 1) : 1;
  return share * share * (3 - 2 * share);
}

/** A frame of the video, counted from the group's first and kept within what the group holds. */
export function clampFrame(group: Span, frame: number): number {
  return Math.min(Math.max(frame - group.firstFrame, 0), Math.max(group.frames - 1, 0));
}

export const ALIVE_NOW = 1;
export const ALIVE_BEFORE = 2;

/** Which static points a group shows: of some layers, one after the other. */
export interface Alive {
  alive: Uint8Array;
  layers: string[];
}

/**
 * By layer, which of its points show in a group and in the one before it, as bits ALIVE_NOW and ALIVE_BEFORE. counts: points of
 * each layer. Points that a bitmap does not tell of are not alive in its group. Without a group before (null) nothing fades: what
 * is alive is alive in both. Without a group at all everything is.
 */
export function staticFlags(counts: Map<string, number>, now: Alive | null, before: Alive | null): Map<string, Uint8Array> {
  const flags = new Map([...counts].map(([layer, count]) => [layer, new Uint8Array(count).fill(now ? 0 : ALIVE_NOW | ALIVE_BEFORE)]));
  const mark = ({ alive, layers }: Alive, bit: number): void => {
    let first = 0;
    for (const layer of layers) {
      const own = flags.get(layer);
      if (!own) return; // where the next one begins is not known
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

/** Weight of a static point by its flags, 0..3. */
export function staticWeights(weight: number): [number, number, number, number] {
  return [0, weight, 1 - weight, 1];
}
