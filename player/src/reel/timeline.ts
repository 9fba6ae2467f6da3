/** What is shown at time t: the rules of "Showing time t" in docs/format.md. */

export interface Span {
  firstFrame: number;
  frames: number;
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

/** The last group whose first frame is at most `frame` (the first group for earlier times). */
export function groupAt(groups: Span[], frame: number): number {
  let low = 0;
  let high = groups.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (groups[middle].firstFrame <= frame) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** The moment at `seconds`. */
export function momentAt(groups: Span[], overlap: number, fps: number, seconds: number): Moment {
  const frame = seconds * fps;
  return momentOf(groups, overlap, frame, groupAt(groups, frame));
}

/** The moment at a frame of the video if `group` is taken as the current one, whether or not its time has come. */
export function momentOf(groups: Span[], overlap: number, frame: number, group: number): Moment {
  const since = frame - groups[group].firstFrame;
  const share = overlap > 0 ? Math.min(Math.max(since / overlap, 0), 1) : 1;
  const weight = share * share * (3 - 2 * share);
  const fading = weight < 1 && group > 0;
  return {
    current: { group, frame: clampFrame(groups[group], frame) },
    previous: fading ? { group: group - 1, frame: clampFrame(groups[group - 1], frame) } : null,
    weight: fading ? weight : 1,
  };
}

/** A frame of the video, counted from the group's first and kept within what the group holds. */
export function clampFrame(group: Span, frame: number): number {
  return Math.min(Math.max(frame - group.firstFrame, 0), Math.max(group.frames - 1, 0));
}

export const ALIVE_NOW = 1;
export const ALIVE_BEFORE = 2;

/**
 * Which static points [total] show in a group and in the one before it, as bits ALIVE_NOW and ALIVE_BEFORE.
 * A bitmap covers the layers born up to its group; later points are not alive in it. Without a group before (null), nothing
 * fades: what is alive is alive in both.
 */
export function staticFlags(total: number, now: Uint8Array, before: Uint8Array | null): Uint8Array {
  const flags = new Uint8Array(total);
  for (let i = 0; i < Math.min(total, now.length); i++) flags[i] = now[i] * ALIVE_NOW;
  const earlier = before ?? now;
  for (let i = 0; i < Math.min(total, earlier.length); i++) flags[i] |= earlier[i] * ALIVE_BEFORE;
  return flags;
}

/** Weight of a static point by its flags, 0..3. */
export function staticWeights(weight: number): [number, number, number, number] {
  return [0, weight, 1 - weight, 1];
}
