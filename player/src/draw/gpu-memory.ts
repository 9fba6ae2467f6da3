/** What of a reel is on the GPU: the points of its layers and groups, each file with rows of its own in the splat target. */
import type { Vec3 } from "../base/matrix";
import type { DecodedFile } from "../decode/decode-file";
import { lightAt } from "../decode/light";
import { staticFlags, type Alive } from "../reel/timeline";
import { RowAllocator } from "./row-allocator";
import type { Scene } from "./scene";
import { SplatTarget } from "./splat-target";
import { TEXTURE_WIDTH } from "./texture-layout";
import { PointTextures, rowsOf } from "./textures";

interface Group extends Alive {
  textures: PointTextures;
  light: Float32Array | null;
}

export class GpuMemory {
  readonly target: SplatTarget;
  /** By their uris. */
  private readonly layers = new Map<string, PointTextures>();
  private readonly groups = new Map<number, Group>();
  private readonly rows = new RowAllocator();
  /** Of the scene that the static points' flags are for. */
  private flagsKey = "";

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.target = new SplatTarget(gl);
  }

  /** Upload a layer; returns the index of its first point in the draw order. */
  addLayer(uri: string, file: DecodedFile): number {
    const textures = this.upload(file);
    this.layers.set(uri, textures);
    this.flagsKey = "";
    return textures.firstRow * TEXTURE_WIDTH;
  }

  /** Upload a group, which tells what is alive of these layers; returns the index of its first point in the draw order. */
  addGroup(index: number, file: DecodedFile, layers: string[]): number {
    const textures = this.upload(file);
    this.groups.set(index, { textures, alive: file.alive, layers, light: file.light });
    return textures.firstRow * TEXTURE_WIDTH;
  }

  dropGroup(index: number): void {
    this.free(this.groups.get(index)?.textures);
    this.groups.delete(index);
  }

  dropLayer(uri: string): void {
    this.free(this.layers.get(uri));
    this.layers.delete(uri);
  }

  /** Whether all of a scene is here. */
  holds({ current, previous, layers }: Scene): boolean {
    return [current, previous].every((shown) => shown === null || this.groups.has(shown.group)) && layers.every((uri) => this.layers.has(uri));
  }

  /** Those of a scene that are here. */
  layersOf(scene: Scene): PointTextures[] {
    return scene.layers.flatMap((uri) => this.layers.get(uri) ?? []);
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
    const counts = new Map(scene.layers.map((uri) => [uri, this.layers.get(uri)?.count ?? 0]));
    const [now, before] = [scene.current, scene.previous].map((shown) => shown && this.groups.get(shown.group)!);
    for (const [uri, flags] of staticFlags(counts, now, before)) this.layers.get(uri)?.setFlags(flags);
  }

  delete(): void {
    for (const layer of this.layers.values()) layer.delete();
    for (const { textures } of this.groups.values()) textures.delete();
    this.target.delete();
  }

  private free(textures: PointTextures | undefined): void {
    if (!textures) return;
    this.rows.give(textures.firstRow, rowsOf(textures.count));
    textures.delete();
  }

  private upload(file: DecodedFile): PointTextures {
    const firstRow = this.rows.take(rowsOf(file.points.count));
    this.target.reserve(this.rows.end);
    return new PointTextures(this.gl, firstRow, file.points, file.offsets);
  }
}
