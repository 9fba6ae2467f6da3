/** Edits of the keyframes of a camera path. Each returns a new list. */
import type { Keyframe } from "./camera-path";

/** Seconds between keyframes of the same reel time. */
const STEP = 2;
/** Minimum seconds between keyframes. */
const LEAST = 0.1;

/** Append a keyframe, as much later as its reel time is later, so that the reel plays at its own rate. */
export function appended(keyframes: Keyframe[], time: number, viewmat: number[]): Keyframe[] {
  const last = keyframes.at(-1);
  const later = last ? time - last.time : 0;
  return [...keyframes, { at: last ? rounded(last.at + (later >= LEAST ? later : STEP)) : 0, time, viewmat }];
}

/** Remove a keyframe. The path begins at 0 again. */
export function without(keyframes: Keyframe[], index: number): Keyframe[] {
  const left = keyframes.filter((_, i) => i !== index);
  const first = left[0]?.at ?? 0;
  return left.map((keyframe) => ({ ...keyframe, at: rounded(keyframe.at - first) }));
}

/** Move a keyframe to another time after the one before it. Those after it move along. */
export function moved(keyframes: Keyframe[], index: number, at: number): Keyframe[] {
  const shift = Math.max(at, keyframes[index - 1].at + LEAST) - keyframes[index].at;
  return keyframes.map((keyframe, i) => (i < index ? keyframe : { ...keyframe, at: rounded(keyframe.at + shift) }));
}

/** Scale the path to a duration. */
export function lasting(keyframes: Keyframe[], seconds: number): Keyframe[] {
  const now = keyframes.at(-1)?.at ?? 0;
  if (now === 0) return keyframes;
  const factor = Math.max(seconds, LEAST * (keyframes.length - 1)) / now;
  return keyframes.map((keyframe, i) => ({ ...keyframe, at: i === 0 ? 0 : keyframe.at * factor }));
}

/** Return evenly spaced keyframes through views while the reel plays once, slower if the moves would be too fast. */
export function throughViews(viewmats: number[][], begin: number, end: number): Keyframe[] {
  const legs = viewmats.length - 1;
  const seconds = Math.max(end - begin, LEAST, legs * STEP);
  return viewmats.map((viewmat, i) => ({
    at: rounded((i / Math.max(legs, 1)) * seconds),
    time: begin + (i / Math.max(legs, 1)) * (end - begin),
    viewmat,
  }));
}

function rounded(seconds: number): number {
  return Math.round(seconds * 1000) / 1000;
}
