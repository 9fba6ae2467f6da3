/** Buttons over the picture: a click or a tap is theirs, a drag or the wheel that begins on them is the picture's. */

/** A move of more pixels than this is a drag. */
const DRAG = 6;

/** Pass the gestures that begin on a button on to the surface below. */
export function passGestures(button: HTMLElement, surface: HTMLElement): void {
  /** Pointers that came down and have not moved, by their ids. */
  const resting = new Map<number, PointerEvent>();
  let dragged = false;
  const pass = (): void => {
    dragged = true;
    // The surface captures these pointers, and hears the rest by itself.
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
  for (const name of ["pointerup", "pointercancel", "pointerleave"] as const) button.addEventListener(name, ({ pointerId }) => resting.delete(pointerId));
  button.addEventListener("click", (event) => dragged && event.stopImmediatePropagation(), { capture: true });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("wheel", (event) => {
    if (!surface.dispatchEvent(new WheelEvent("wheel", event))) event.preventDefault();
  }, { passive: false });
}
