/** Mouse, wheel and touch to camera moves: drag orbits, right or shift drag and two fingers pan, wheel and pinch zoom. */
import type { OrbitCamera } from "./camera";

/** Radians a pixel of drag, as a part of the surface's shorter side per half turn. */
const HALF_TURN = Math.PI;
/** A pause of this many milliseconds before letting go means no flick. */
const STILL = 60;

interface Finger {
  x: number;
  y: number;
  pan: boolean;
}

/** Steer a camera from a surface. `camera` may be null while nothing is loaded. Returns a function that lets go of it. */
export function attachControls(surface: HTMLElement, camera: () => OrbitCamera | null, focal: () => number, changed: () => void): () => void {
  const fingers = new Map<number, Finger>();
  let velocity: [number, number] = [0, 0];
  let moved = 0;

  const down = (event: PointerEvent): void => {
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, pan: event.button !== 0 || event.shiftKey });
    surface.setPointerCapture(event.pointerId);
    camera()?.flick(0, 0);
    velocity = [0, 0];
  };
  const move = (event: PointerEvent): void => {
    const finger = fingers.get(event.pointerId);
    const target = camera();
    if (!finger || !target) return;
    const dx = event.clientX - finger.x;
    const dy = event.clientY - finger.y;
    if (fingers.size === 1 && !finger.pan) {
      const unit = HALF_TURN / Math.max(Math.min(surface.clientWidth, surface.clientHeight), 1);
      target.orbit(dx * unit, dy * unit);
      const seconds = Math.max((event.timeStamp - moved) / 1000, 0.004);
      const blend = (old: number, now: number): number => 0.6 * old + 0.4 * now;
      velocity = [blend(velocity[0], (dx * unit) / seconds), blend(velocity[1], (dy * unit) / seconds)];
    } else {
      if (fingers.size > 1) target.zoom(spread(fingers) / spread(fingers, event));
      target.pan(dx / fingers.size, dy / fingers.size, focal());
    }
    moved = event.timeStamp;
    [finger.x, finger.y] = [event.clientX, event.clientY];
    changed();
  };
  const up = (event: PointerEvent): void => {
    const finger = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (finger && !finger.pan && fingers.size === 0 && event.timeStamp - moved < STILL) camera()?.flick(...velocity);
    changed();
  };
  const wheel = (event: WheelEvent): void => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    camera()?.zoom(Math.exp(Math.min(Math.max(event.deltaY * lines, -200), 200) * 0.0015));
    changed();
  };
  const menu = (event: Event): void => event.preventDefault();

  surface.addEventListener("pointerdown", down);
  surface.addEventListener("pointermove", move);
  surface.addEventListener("pointerup", up);
  surface.addEventListener("pointercancel", up);
  surface.addEventListener("wheel", wheel, { passive: false });
  surface.addEventListener("contextmenu", menu);
  return () => {
    surface.removeEventListener("pointerdown", down);
    surface.removeEventListener("pointermove", move);
    surface.removeEventListener("pointerup", up);
    surface.removeEventListener("pointercancel", up);
    surface.removeEventListener("wheel", wheel);
    surface.removeEventListener("contextmenu", menu);
  };
}

/** Mean distance of the fingers from their middle, with one of them where an event says. */
function spread(fingers: Map<number, Finger>, event?: PointerEvent): number {
  const points = [...fingers].map(([id, finger]) => (event && id === event.pointerId ? { x: event.clientX, y: event.clientY } : finger));
  const x = points.reduce((sum, point) => sum + point.x, 0) / points.length;
  const y = points.reduce((sum, point) => sum + point.y, 0) / points.length;
  return Math.max(points.reduce((sum, point) => sum + Math.hypot(point.x - x, point.y - y), 0) / points.length, 1);
}
