/** What people do to the keyframes of a camera path; each gives new ones. */
import type { Keyframe } from "./camera-path";

/** Seconds from one keyframe to the next where the reel's time says nothing. */
const STEP = 2;
/** Least seconds between two. */
const LEAST = 0.1;

/** One more at the end: as much later as the reel's time is later, so that it plays at its own pace. */
export function appended(keyframes: Keyframe[], time: number, viewmat: number[]): Keyframe[] {
  const last = keyframes.at(-1);
  const later = last ? time - last.time : 0;
  return [...keyframes, { at: last ? rounded(last.at + (later >= LEAST ? later : STEP)) : 0, time, viewmat }];
}

/** Without one; what follows the first begins at 0. */
export function without(keyframes: Keyframe[], index: number): Keyframe[] {
  const left = keyframes.filter((_, i) => i !== index);
  const first = left[0]?.at ?? 0;
  return left.map((keyframe) => ({ ...keyframe, at: rounded(keyframe.at - first) }));
}

/** One at other seconds, at least a little after the one before; those after it keep their distances. */
export function moved(keyframes: Keyframe[], index: number, at: number): Keyframe[] {
  const shift = Math.max(at, keyframes[index - 1].at + LEAST) - keyframes[index].at;
  return keyframes.map((keyframe, i) => (i < index ? keyframe : { ...keyframe, at: rounded(keyframe.at + shift) }));
}

/** All of it in so many seconds. */
export function lasting(keyframes: Keyframe[], seconds: number): Keyframe[] {
  const now = keyframes.at(-1)?.at ?? 0;
  if (now === 0) return keyframes;
  const factor = Math.max(seconds, LEAST * (keyframes.length - 1)) / now;
  return keyframes.map((keyframe, i) => ({ ...keyframe, at: i === 0 ? 0 : keyframe.at * factor }));
}

/** Through views, evenly, while the reel plays once, from its begin to its end; slower than its pace where that is too fast to look at. */
export function throughViews(viewmats: number[][], begin: number, end: number): Keyframe[] {
  const legs = viewmats.length - 1;
  const seconds = Math.max(end - begin, LEAST, legs * STEP);
  return viewmats.map((viewmat, i) => ({ at: rounded((i / Math.max(legs, 1)) * seconds), time: begin + (i / Math.max(legs, 1)) * (end - begin), viewmat }));
}

function rounded(seconds: number): number {
  return Math.round(seconds * 1000) / 1000;
}
