/** The one place that chooses how the player draws. */
import { type GraphicsDevice, WebglDevice } from "@splatreel/renderer";

/** Return the graphics device of a canvas. onlost, onrestored: called when the browser takes the device away and when it returns. */
export function graphicsDeviceOf(
  canvas: HTMLCanvasElement,
  onlost: () => void,
  onrestored: () => void,
): GraphicsDevice {
  return new WebglDevice(canvas, onlost, onrestored);
}
