/** GPU memory of a reel: the points of its layers and groups. Each file owns rows of the splat target. */
import type { Vec3 } from "@splatreel/decoder/base/matrix";
import type { DecodedFile, DecodedGroup, DecodedLayer } from "@splatreel/decoder/decode/decode-file";
import { lightAt } from "@splatreel/decoder/decode/light";
import { staticFlags, type Alive } from "@splatreel/decoder/reel/timeline";
import { RowAllocator } from "./row-allocator";
import type { Scene } from "../draw/scene";
import { SplatTarget } from "./splat-target";
import { TEXTURE_WIDTH } from "../draw/texture-layout";
import { PointTextures, rowsOf } from "./textures";

interface Group extends Alive {
  textures: PointTextures;
  light: Float32Array | null;
}

/** Textures of all loaded files. */
export class GpuMemory {
  readonly target: SplatTarget;
  /** By URI. */
  private readonly layers = new Map<string, PointTextures>();
  private readonly groups = new Map<number, Group>();
  private readonly rows = new RowAllocator();
  /** Scene for which the flags of static points were uploaded. */
  private flagsKey = "";

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.target = new SplatTarget(gl);
  }

  /** Upload a layer. Returns the index of its first point in the draw order. */
  addLayer(uri: string, file: DecodedLayer): number {
    const textures = this.upload(file);
    this.layers.set(uri, textures);
    this.flagsKey = "";
    return textures.firstRow * TEXTURE_WIDTH;
  }

  /** Upload a group. layers: URIs of the layers that `alive` covers. Returns the index of its first point in the draw order. */
  addGroup(index: number, file: DecodedGroup, layers: string[]): number {
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

  /** Return true if all of a scene is uploaded. */
  holds({ current, previous, layers }: Scene): boolean {
    return [current, previous].every((shown) => shown === null || this.groups.has(shown.group)) && layers.every((uri) => this.layers.has(uri));
  }

  /** Return the uploaded layers of a scene. */
  layersOf(scene: Scene): PointTextures[] {
    return scene.layers.flatMap((uri) => this.layers.get(uri) ?? []);
  }

  /** Return the textures of a group; null if it is not uploaded. */
  group(index: number): PointTextures | null {
    return this.groups.get(index)?.textures ?? null;
  }

  /** Return the red, green and blue factors of a scene's light, relative to its keyframe. */
  lightOf({ current }: Scene): Vec3 {
    return current ? lightAt(this.groups.get(current.group)!.light, current.frame) : [1, 1, 1];
  }

  /** Upload which static points are alive in the groups of a scene. */
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
    return new PointTextures(this.gl, firstRow, file.points, file.kind === "group" ? file.offsets : null);
  }
}
