/** The one place that chooses how the player draws. */
import type { GraphicsDevice } from "../draw/renderer";
import { WebglDevice } from "../webgl/webgl-device";

/** Return the graphics device of a canvas. onlost, onrestored: called when the browser takes the device away and when it returns. */
export function graphicsDeviceOf(canvas: HTMLCanvasElement, onlost: () => void, onrestored: () => void): GraphicsDevice {
  return new WebglDevice(canvas, onlost, onrestored);
}
