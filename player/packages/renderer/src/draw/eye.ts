import type { View } from "../base/view";

/** A view and its place in a framebuffer (null for the canvas). x, y: lower left corner in pixels. */
export interface Eye {
  framebuffer: WebGLFramebuffer | null;
  x: number;
  y: number;
  view: View;
}
