/** Lets drags and wheel events on buttons control the picture below, while clicks stay with the button. */

/** Pixels above which a move is a drag. */
const DRAG = 6;

/** Pass the gestures that begin on a button on to the surface below. */
export function passGestures(button: HTMLElement, surface: HTMLElement): void {
  /** Pressed pointers that have not moved, by id. */
  const resting = new Map<number, PointerEvent>();
  let dragged = false;
  const pass = (): void => {
    dragged = true;
    // The surface captures these pointers and receives their further events.
    for (const event of resting.values()) surface.dispatchEvent(new PointerEvent("pointerdown", event));
    resting.clear();
  };
  button.addEventListener("pointerdown", (event) => {
    if (resting.size === 0) dragged = false;
    resting.set(event.pointerId, event);
    if (resting.size > 1 || event.button !== 0) pass();
  });
  button.addEventListener("pointermove", (event) => {
    const began = resting.get(event.pointerId);
    if (!began || Math.hypot(event.clientX - began.clientX, event.clientY - began.clientY) <= DRAG) return;
    pass();
    surface.dispatchEvent(new PointerEvent("pointermove", event));
  });
  for (const name of ["pointerup", "pointercancel", "pointerleave"] as const)
    button.addEventListener(name, ({ pointerId }) => resting.delete(pointerId));
  button.addEventListener("click", (event) => dragged && event.stopImmediatePropagation(), { capture: true });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener(
    "wheel",
    (event) => {
      if (!surface.dispatchEvent(new WheelEvent("wheel", event))) event.preventDefault();
    },
    { passive: false },
  );
}
