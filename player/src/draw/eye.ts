import type { View } from "../base/view";

/** A view and where it is drawn: a part of a framebuffer (null: the canvas), from the lower left. */
export interface Eye {
  framebuffer: WebGLFramebuffer | null;
  x: number;
  y: number;
  view: View;
}
