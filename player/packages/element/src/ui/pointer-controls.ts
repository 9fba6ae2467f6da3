/** Mouse and touch control: drag orbits, right or Shift drag and two fingers pan, wheel and pinch zoom. */
import type { Player } from "../player/player";
import type { CooperativeGestures } from "./cooperative-gestures";

/** Rotation in radians of a drag along the shorter side of the surface. */
const HALF_TURN = Math.PI;
/** Milliseconds without a move before the release that suppress a flick. */
const STILL = 60;
/** Maximum milliseconds between taps of a double tap, and maximum pixels of a tap. */
const DOUBLE = 320;
const NEAR = 12;

/** Return the position of a pointer in the layout pixels of a box, which a transform or zoom of the page scales. */
export function placeIn(box: HTMLElement, { clientX, clientY }: MouseEvent): [number, number] {
  const { left, top } = box.getBoundingClientRect();
  const scale = scaleOf(box);
  return [(clientX - left) / scale, (clientY - top) / scale];
}

/** Return the screen pixels of a layout pixel of a box. */
export function scaleOf(box: HTMLElement): number {
  return box.getBoundingClientRect().width / box.offsetWidth || 1;
}

interface Finger {
  x: number;
  y: number;
  pan: boolean;
  touch: boolean;
}

/** Control the camera of a player from a surface, until the signal. skip: called for a double tap at the left (-1) or right (1) side. */
export function attachPointerControls(
  surface: HTMLElement,
  player: Player,
  gestures: CooperativeGestures,
  skip: (side: -1 | 1) => void,
  signal: AbortSignal,
): void {
  const fingers = new Map<number, Finger>();
  let velocity: [number, number] = [0, 0];
  let moved = 0;
  let way = 0;
  let tap = { x: 0, y: 0, time: -Infinity };

  const down = (event: PointerEvent): void => {
    fingers.set(event.pointerId, {
      x: event.clientX,
      y: event.clientY,
      pan: event.button !== 0 || event.shiftKey,
      touch: event.pointerType === "touch",
    });
    surface.setPointerCapture(event.pointerId);
    player.camera?.hold();
    velocity = [0, 0];
    way = 0;
  };
  const move = (event: PointerEvent): void => {
    const finger = fingers.get(event.pointerId);
    const { camera } = player;
    if (!finger || !camera) return;
    const scale = scaleOf(surface);
    const dx = (event.clientX - finger.x) / scale;
    const dy = (event.clientY - finger.y) / scale;
    way += Math.hypot(dx, dy) * scale;
    if (way === 0) return;
    if (fingers.size === 1 && finger.touch && !gestures.active) {
      // The finger scrolls the page.
    } else if (fingers.size === 1 && !finger.pan) {
      const unit = HALF_TURN / Math.max(Math.min(surface.clientWidth, surface.clientHeight), 1);
      camera.orbit(dx * unit, dy * unit);
      const seconds = Math.max((event.timeStamp - moved) / 1000, 0.004);
      velocity = [(dx * unit) / seconds, (dy * unit) / seconds];
    } else {
      if (fingers.size > 1) camera.zoom(spread(fingers) / spread(fingers, event));
      camera.pan(dx / fingers.size, dy / fingers.size, camera.view(surface.clientWidth, surface.clientHeight).fx);
    }
    moved = event.timeStamp;
    [finger.x, finger.y] = [event.clientX, event.clientY];
    player.invalidate();
  };
  const up = (event: PointerEvent): void => {
    const finger = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (!finger || fingers.size > 0) return;
    player.camera?.release();
    if (!finger.pan && event.timeStamp - moved < STILL) player.camera?.flick(...velocity);
    if (way < NEAR && event.type === "pointerup") tapped(event);
    player.invalidate();
  };
  const tapped = (event: PointerEvent): void => {
    const double =
      event.timeStamp - tap.time < DOUBLE && Math.hypot(event.clientX - tap.x, event.clientY - tap.y) < 2 * NEAR;
    tap = { x: event.clientX, y: event.clientY, time: double ? -Infinity : event.timeStamp };
    if (!double) return;
    const [x, y] = placeIn(surface, event);
    const across = x / surface.offsetWidth;
    if (event.pointerType === "touch" && Math.abs(across - 0.5) > 1 / 6) skip(across < 0.5 ? -1 : 1);
    else focusAt(player, x, y);
  };
  const wheel = (event: WheelEvent): void => {
    if (!gestures.takesWheel(event)) return;
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    player.camera?.zoom(Math.exp(Math.min(Math.max(event.deltaY * lines, -200), 200) * 0.0015));
    player.invalidate();
  };

  surface.addEventListener("pointerdown", down, { signal });
  surface.addEventListener("pointermove", move, { signal });
  surface.addEventListener("pointerup", up, { signal });
  surface.addEventListener("pointercancel", up, { signal });
  surface.addEventListener("wheel", wheel, { passive: false, signal });
  surface.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
}

/** Turn to the point seen at a position of the canvas, in CSS pixels, and make it the pivot. */
function focusAt({ camera, stage, canvas }: Player, x: number, y: number): void {
  const view = stage?.view;
  if (!camera || !view) return;
  const ratio = view.width / canvas.clientWidth;
  const depth = stage.depthAt(x * ratio, y * ratio);
  if (depth !== null)
    camera.focus([((x * ratio - view.cx) / view.fx) * depth, ((y * ratio - view.cy) / view.fy) * depth, depth]);
}

/** Return the mean distance of the fingers from their center. event: updates one of them. */
function spread(fingers: Map<number, Finger>, event?: PointerEvent): number {
  const points = [...fingers].map(([id, finger]) =>
    event && id === event.pointerId ? { x: event.clientX, y: event.clientY } : finger,
  );
  const x = points.reduce((sum, point) => sum + point.x, 0) / points.length;
  const y = points.reduce((sum, point) => sum + point.y, 0) / points.length;
  return Math.max(points.reduce((sum, point) => sum + Math.hypot(point.x - x, point.y - y), 0) / points.length, 1);
}
