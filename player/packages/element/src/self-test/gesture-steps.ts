/** Tests that people do by hand. Each resolves with what happened once it worked; the reel must have followed. */
import type { CameraState } from "../camera/pose";
import type { Player } from "../player/player";

/** Radians of a drag and factor of a pinch that count. */
const TURNED = 0.1;
const PINCHED = 1.1;
/** Milliseconds within which two taps are a double tap, and in which the reel answers it. */
const DOUBLE = 320;
const ANSWER = 600;

/** Resolve once one finger has turned the view. */
export function dragTest({ canvas, camera }: Player, signal: AbortSignal): Promise<string> {
  return watchFingers(canvas, signal, (fingers, start) => {
    const angle = fingers === 1 ? angleBetween(start(camera!.state), camera!.state) : 0;
    return angle > TURNED ? `turned the view by ${Math.round((180 * angle) / Math.PI)} degrees` : null;
  });
}

/** Resolve once two fingers have changed the distance. */
export function pinchTest({ canvas, camera }: Player, signal: AbortSignal): Promise<string> {
  return watchFingers(canvas, signal, (fingers, start) => {
    const factor = fingers === 2 ? start(camera!.state).distance / camera!.state.distance : 1;
    return Math.max(factor, 1 / factor) > PINCHED
      ? `changed the distance by a factor of ${(1 / factor).toFixed(2)}`
      : null;
  });
}

/** Resolve once a double tap has chosen a new middle, or has stepped through the time. */
export function doubleTapTest(player: Player, signal: AbortSignal): Promise<string> {
  const { canvas, camera } = player;
  return new Promise((resolve) => {
    let last = -Infinity;
    canvas.addEventListener(
      "pointerup",
      ({ timeStamp }) => {
        const double = timeStamp - last < DOUBLE;
        last = double ? -Infinity : timeStamp;
        if (!double) return;
        const [before, time] = [camera!.state, player.currentTime];
        setTimeout(() => {
          const { state } = camera!;
          if (Math.abs(player.currentTime - time) > 0.02 && player.paused) resolve("stepped through the time");
          else if (angleBetween(before, state) > 0.005 || Math.abs(state.distance / before.distance - 1) > 0.005)
            resolve("chose a new middle");
        }, ANSWER);
      },
      { signal },
    );
  });
}

/** Resolve once the window has been turned and the picture fills its place. */
export function rotationTest({ canvas }: Player, signal: AbortSignal): Promise<string> {
  const lies = (): boolean => innerWidth > innerHeight;
  const [before, size] = [lies(), `${innerWidth} x ${innerHeight}`];
  return new Promise((resolve, reject) => {
    addEventListener(
      "resize",
      () => {
        if (lies() === before) return;
        setTimeout(() => {
          const wide = document.documentElement.scrollWidth > innerWidth;
          const skew = (canvas.width * canvas.clientHeight) / (canvas.height * canvas.clientWidth);
          if (wide || Math.abs(skew - 1) > 0.05)
            reject(new Error(wide ? "the page is wider than the screen" : "the picture is distorted"));
          else resolve(`from ${size} to ${innerWidth} x ${innerHeight}`);
        }, ANSWER);
      },
      { signal },
    );
  });
}

/** Call `done` at each move with the number of fingers on a canvas, until it returns a text. start: remembers a value of the first call per number of fingers. */
function watchFingers(
  canvas: HTMLElement,
  signal: AbortSignal,
  done: (fingers: number, start: <T>(now: T) => T) => string | null,
): Promise<string> {
  return new Promise((resolve) => {
    const fingers = new Set<number>();
    let first: unknown = null;
    canvas.addEventListener(
      "pointerdown",
      ({ pointerId }) => {
        fingers.add(pointerId);
        first = null;
      },
      { signal },
    );
    for (const name of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(name, ({ pointerId }) => (fingers.delete(pointerId), (first = null)), { signal });
    canvas.addEventListener(
      "pointermove",
      () => {
        const text = done(fingers.size, <T>(now: T) => (first ??= now) as T);
        if (text !== null) resolve(text);
      },
      { signal },
    );
  });
}

/** Return the angle between two views, in radians. */
function angleBetween(a: CameraState, b: CameraState): number {
  const dot = a.turn.reduce((sum, value, i) => sum + value * b.turn[i], 0);
  return 2 * Math.acos(Math.min(Math.abs(dot), 1));
}
