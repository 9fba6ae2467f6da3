/** The WebGL 2 context of a canvas, released by losing it and acquired by restoring it. */
import type { GraphicsDevice, Renderer } from "../draw/renderer";
import { WebglRenderer } from "./webgl-renderer";

/** The device on which `WebglRenderer` draws. */
export class WebglDevice implements GraphicsDevice {
  private extension: WEBGL_lose_context | null = null;
  private lost: Promise<unknown> = Promise.resolve();
  private acquiring: Promise<void> | null = null;

  /** onlost, onrestored: not called for `release` and `acquire`. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    onlost: () => void,
    onrestored: () => void,
  ) {
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // without this the browser never restores the context
      if (!this.released) onlost();
    });
    canvas.addEventListener("webglcontextrestored", () => void (!this.released && onrestored()));
  }

  get released(): boolean {
    return this.extension !== null;
  }

  createRenderer(): Renderer {
    return new WebglRenderer(this.canvas);
  }

  /** Give the device back, if the canvas has one. */
  release(): void {
    const extension = this.released
      ? null
      : (this.canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context") ?? null);
    if (!extension) return;
    this.extension = extension;
    this.lost = this.next("webglcontextlost");
    extension.loseContext();
  }

  acquire(): Promise<void> {
    this.acquiring ??= this.restore().finally(() => (this.acquiring = null));
    return this.acquiring;
  }

  private async restore(): Promise<void> {
    const { extension } = this;
    if (!extension) return;
    await this.lost;
    await new Promise((resolve) => setTimeout(resolve)); // a context cannot be restored within its loss event
    const restored = this.next("webglcontextrestored");
    extension.restoreContext();
    await restored;
    this.extension = null;
  }

  private next(event: string): Promise<unknown> {
    return new Promise((resolve) => this.canvas.addEventListener(event, resolve, { once: true }));
  }
}
