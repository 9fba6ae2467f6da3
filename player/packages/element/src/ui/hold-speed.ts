/** Plays twice as fast while people hold the picture. */
import type { Player } from "../player/player";

/** Milliseconds after which a press is a hold, and pixels above which it is a drag. */
const HOLD = 500;
const DRAG = 8;

/** Follow presses of a surface until the signal. changed: called when the speed rises, and when it is as before. */
export function attachHoldSpeed(
  surface: HTMLElement,
  player: Player,
  changed: (fast: boolean) => void,
  signal: AbortSignal,
): void {
  let press: { x: number; y: number; timer: number } | null = null;
  let before: number | null = null;
  const end = (): void => {
    if (press) clearTimeout(press.timer);
    press = null;
    if (before === null) return;
    player.playbackRate = before;
    before = null;
    changed(false);
  };
  const begin = (): void => {
    if (player.paused || player.playback.callerDraws) return;
    before = player.playbackRate;
    player.playbackRate = 2 * before;
    changed(true);
  };
  surface.addEventListener(
    "pointerdown",
    ({ clientX: x, clientY: y, button, shiftKey, isPrimary }) => {
      end();
      if (button === 0 && !shiftKey && isPrimary) press = { x, y, timer: window.setTimeout(begin, HOLD) };
    },
    { signal },
  );
  surface.addEventListener(
    "pointermove",
    ({ clientX, clientY }) => {
      if (press && before === null && Math.hypot(clientX - press.x, clientY - press.y) > DRAG) end();
    },
    { signal },
  );
  for (const name of ["pointerup", "pointercancel"]) surface.addEventListener(name, end, { signal });
  for (const name of ["pause", "emptied"]) player.addEventListener(name, end, { signal });
  signal.addEventListener("abort", end);
}
