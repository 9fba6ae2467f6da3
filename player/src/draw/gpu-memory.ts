/** What of a reel is on the GPU: the points of its layers and groups, each file with rows of its own in the splat target. */
import type { Vec3 } from "../base/matrix";
import type { DecodedFile } from "../decode/decode-file";
import { lightAt } from "../decode/light";
import { staticFlags } from "../reel/timeline";
import { RowAllocator } from "./row-allocator";
import type { Scene } from "./scene";
import { SplatTarget } from "./splat-target";
import { TEXTURE_WIDTH } from "./texture-layout";
import { PointTextures, rowsOf } from "./textures";

interface Group {
  textures: PointTextures;
  alive: Uint8Array;
  light: Float32Array | null;
}

export class GpuMemory {
  readonly target: SplatTarget;
  private readonly layers: PointTextures[] = [];
  private readonly groups = new Map<number, Group>();
  private readonly rows = new RowAllocator();
  /** Of the scene that the static points' flags are for. */
  private flagsKey = "";

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.target = new SplatTarget(gl);
  }

  /** Upload a layer; returns the index of its first point in the draw order. */
  addLayer(index: number, file: DecodedFile): number {
    const textures = this.upload(file);
    this.layers[index] = textures;
    this.flagsKey = "";
    return textures.firstRow * TEXTURE_WIDTH;
  }

  /** Upload a group; returns the index of its first point in the draw order. */
  addGroup(index: number, file: DecodedFile): number {
    const textures = this.upload(file);
    this.groups.set(index, { textures, alive: file.alive, light: file.light });
    return textures.firstRow * TEXTURE_WIDTH;
  }

  dropGroup(index: number): void {
    const textures = this.groups.get(index)?.textures;
    if (!textures) return;
    this.groups.delete(index);
    this.rows.give(textures.firstRow, rowsOf(textures.count));
    textures.delete();
  }

  /** Whether a scene's groups are here. */
  holds({ current, previous }: Scene): boolean {
    return (current === null || this.groups.has(current.group)) && (previous === null || this.groups.has(previous.group));
  }

  layersOf(scene: Scene): PointTextures[] {
    return this.layers.slice(0, scene.layers);
  }

  /** A group's points; null where it is not here. */
  group(index: number): PointTextures | null {
    return this.groups.get(index)?.textures ?? null;
  }

  /** Red, green and blue by which a scene's light differs from its keyframe's. */
  lightOf({ current }: Scene): Vec3 {
    return current ? lightAt(this.groups.get(current.group)!.light, current.frame) : [1, 1, 1];
  }

  /** Let static points show in the groups of a scene in which they are alive. */
  flagStatics(scene: Scene): void {
    const key = `${scene.layers} ${scene.current?.group} ${scene.previous?.group}`;
    if (key === this.flagsKey) return;
    this.flagsKey = key;
    const layers = this.layersOf(scene);
    const total = layers.reduce((sum, layer) => sum + layer.count, 0);
    const now = scene.current ? this.groups.get(scene.current.group)!.alive : new Uint8Array(total).fill(1);
    const flags = staticFlags(total, now, scene.previous ? this.groups.get(scene.previous.group)!.alive : null);
    let first = 0;
    for (const layer of layers) {
      layer.setFlags(flags.subarray(first, first + layer.count));
      first += layer.count;
    }
  }

  delete(): void {
    for (const layer of this.layers) layer?.delete();
    for (const { textures } of this.groups.values()) textures.delete();
    this.target.delete();
  }

  private upload(file: DecodedFile): PointTextures {
    const firstRow = this.rows.take(rowsOf(file.points.count));
    this.target.reserve(this.rows.end);
    return new PointTextures(this.gl, firstRow, file.points, file.offsets);
  }
}
