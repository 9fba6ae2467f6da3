/** Lets PlayCanvas sort the points of a reel. */
import type { Clearance } from "@splatreel/decoder/internal";
import type { CameraComponent } from "playcanvas";
import type { PointSorter, Scene, SortReply, View } from "@splatreel/renderer";
import type { Engine } from "./engine";
import type { PlaycanvasRenderer } from "./playcanvas-renderer";

const NO_ORDER = new Uint32Array();

/** Sorter whose orders are those that PlayCanvas draws. */
export class EngineSorter implements PointSorter {
  busy = false;
  /** Camera whose order counts. */
  camera: CameraComponent | null = null;

  constructor(
    private readonly engine: Engine,
    private readonly renderer: PlaycanvasRenderer,
  ) {}

  addLayer(): void {}

  addGroup(): void {}

  drop(): void {}

  async sort(scene: Scene, view: View, clearance: Clearance, weight: number): Promise<SortReply> {
    this.busy = true;
    const began = performance.now();
    this.renderer.clearance = clearance;
    const count = this.renderer.arrange(scene, weight, view);
    await this.engine.displayed(this.camera);
    this.busy = false;
    return { order: NO_ORDER, count, milliseconds: performance.now() - began };
  }

  recycle(): void {}

  destroy(): void {}
}
