/** Shows the files of a reel as splats of a PlayCanvas scene, which PlayCanvas sorts and draws. */
import {
  type Clearance,
  type DecodedFile,
  type DecodedGroup,
  type DecodedLayer,
  staticWeights,
} from "@splatreel/decoder/internal";
import {
  type Eye,
  frustumOf,
  type HeadsetLayer,
  isSameScene,
  isSameView,
  type Renderer,
  type Scene,
  UploadedFiles,
  type View,
} from "@splatreel/renderer";
import type { Engine } from "./engine";
import { FileSplats } from "./file-splats";
import type { Side } from "./file-textures";

/** Frames without a change after which PlayCanvas keeps what it has read. Before, it may miss single changes while it sorts. */
const STILL = 10;

/** A file of a scene: its frame, and its weights in a cross-fade. */
interface ShownFile {
  splats: FileSplats;
  frame: number;
  weights: number[];
}

/** Files of a reel, as entities. */
class Files extends UploadedFiles<FileSplats, Side> {
  constructor(private readonly engine: Engine) {
    super();
  }

  override get all(): FileSplats[] {
    return super.all;
  }

  protected upload(file: DecodedFile): FileSplats {
    return new FileSplats(this.engine, file);
  }

  protected free(splats: FileSplats): void {
    splats.delete();
  }
}

/** Renderer of one reel. */
export class PlaycanvasRenderer implements Renderer {
  readonly software = false;
  readonly lost = false;
  transparent = false;
  passthrough = false;
  cutaway = null;
  points = 0;
  /** Factor on all opacities, 0 to 1. */
  opacity = 1;
  clearance: Clearance | null = null;
  private readonly files: Files;
  private antialias = false;
  /** Files on both sides, and the side arranged last. */
  private readonly arranged: [FileSplats[], FileSplats[]] = [[], []];
  private side: Side = 0;
  private drawn: { scene: Scene; weight: number; view: View; opacity: number } | null = null;
  private still = 0;

  constructor(engine: Engine) {
    this.files = new Files(engine);
  }

  begin(antialias: boolean): void {
    this.antialias = antialias;
  }

  addLayer(uri: string, file: DecodedLayer): number {
    this.files.addLayer(uri, file);
    return 0;
  }

  addGroup(index: number, file: DecodedGroup, layers: string[]): number {
    this.files.addGroup(index, file, layers);
    return 0;
  }

  dropLayer(uri: string): void {
    this.files.dropLayer(uri);
  }

  dropGroup(index: number): void {
    this.files.dropGroup(index);
  }

  holds(scene: Scene): boolean {
    return this.files.holds(scene);
  }

  /**
   * Show the files of a scene from the next order on, sorted by their positions in it. Returns the number of points.
   * weight: of the current group in a cross-fade.
   */
  arrange(scene: Scene, weight: number, view: View): number {
    const shown = this.filesOf(scene, weight);
    for (const { splats, frame } of shown) splats.move(frame);
    if (this.sideOf(shown) !== this.side) {
      this.side = this.side === 0 ? 1 : 0;
      this.arranged[this.side] = shown.map(({ splats }) => splats);
      this.files.flagStatics(scene, this.side);
      this.drawFiles(shown, scene, view);
      for (const splats of this.files.all)
        for (const side of [0, 1] as const)
          splats.show(side, side === this.side && this.arranged[side].includes(splats));
    }
    return shown.reduce((sum, { splats }) => sum + splats.count, 0);
  }

  setOrder(_order: Uint32Array, count: number): void {
    this.points = count;
  }

  draw(): void {
    throw new Error("PlayCanvas draws the scene.");
  }

  /** Set what PlayCanvas draws in this frame. */
  drawEyes(scene: Scene, weight: number, [{ view }]: Eye[]): void {
    const { drawn, opacity } = this;
    const isStill =
      drawn !== null &&
      drawn.weight === weight &&
      drawn.opacity === opacity &&
      drawn.view.near === view.near &&
      isSameView(drawn.view, view) &&
      isSameScene(drawn.scene, scene);
    this.still = isStill ? this.still + 1 : 0;
    this.drawn = { scene, weight, view, opacity };
    if (this.still > STILL) return;
    for (const splats of this.files.all) splats.keepUpdating(this.still < STILL);
    this.drawFiles(this.filesOf(scene, weight), scene, view);
  }

  readPixels(): Uint8Array {
    throw new Error("Read the canvas of PlayCanvas.");
  }

  depthAt(): null {
    return null;
  }

  createHeadsetLayer(): Promise<HeadsetLayer> {
    return Promise.reject(new Error("PlayCanvas creates the layer."));
  }

  destroy(): void {
    for (const splats of this.files.all) splats.delete();
  }

  /** Return the files of a scene, each with its frame and its weights in a cross-fade. */
  private filesOf(scene: Scene, weight: number): ShownFile[] {
    const layers = this.files
      .layersOf(scene)
      .map((splats) => ({ splats, frame: 0, weights: staticWeights(weight) as number[] }));
    const groups = (
      [
        [scene.current, weight],
        [scene.previous, 1 - weight],
      ] as const
    ).flatMap(([shown, factor]) => {
      const splats = shown && this.files.group(shown.group);
      return splats ? [{ splats, frame: shown.frame, weights: [factor, 0, 0, 0] }] : [];
    });
    return [...layers, ...groups];
  }

  private drawFiles(files: ShownFile[], scene: Scene, view: View): void {
    const { clear } = frustumOf(view, this.clearance);
    const light = this.files.lightOf(scene);
    const common = {
      uLight: light,
      uFocal: [view.fx, view.fy],
      uNear: view.near,
      uClear: clear,
      uAntialias: this.antialias ? 1 : 0,
      uOpacity: this.opacity,
    };
    const side = this.sideOf(files);
    if (side === null) return;
    for (const { splats, frame, weights } of files) splats.draw(side, frame, { ...common, uWeights: weights });
  }

  /** Return the side on which files are placed, preferably the last; null if they are not. */
  private sideOf(files: ShownFile[]): Side | null {
    const isOn = (side: Side): boolean =>
      this.arranged[side].length === files.length && files.every(({ splats }, i) => this.arranged[side][i] === splats);
    const other = this.side === 0 ? 1 : 0;
    return isOn(this.side) ? this.side : isOn(other) ? other : null;
  }
}
