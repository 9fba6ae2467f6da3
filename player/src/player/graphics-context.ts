/** The canvas' graphics device: browsers have some sixteen for all that a page shows, so it is given back where nobody looks. */

export class GraphicsContext {
  private extension: WEBGL_lose_context | null = null;
  private lost: Promise<unknown> = Promise.resolve();
  private coming: Promise<void> | null = null;

  constructor(readonly canvas: HTMLCanvasElement, onlost: () => void, onrestored: () => void) {
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // it may come back
      if (!this.released) onlost();
    });
    canvas.addEventListener("webglcontextrestored", () => void (!this.released && onrestored()));
  }

  /** It was given back. */
  get released(): boolean {
    return this.extension !== null;
  }

  /** Give the device back. The canvas has drawn with it. */
  release(): void {
    const extension = this.released ? null : (this.canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context") ?? null);
    if (!extension) return;
    this.extension = extension;
    this.lost = this.next("webglcontextlost");
    extension.loseContext();
  }

  /** Have the device again. */
  acquire(): Promise<void> {
    this.coming ??= this.restore().finally(() => (this.coming = null));
    return this.coming;
  }

  private async restore(): Promise<void> {
    const { extension } = this;
    if (!extension) return;
    await this.lost;
    await new Promise((resolve) => setTimeout(resolve)); // the event that tells of the loss must be over
    const restored = this.next("webglcontextrestored");
    extension.restoreContext();
    await restored;
    this.extension = null;
  }

  private next(event: string): Promise<unknown> {
    return new Promise((resolve) => this.canvas.addEventListener(event, resolve, { once: true }));
  }
}
