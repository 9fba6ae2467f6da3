/** Files of a reel in the memory of a graphics device: its layers by URI, its groups by number. */
import {
  type Alive,
  type DecodedFile,
  type DecodedGroup,
  type DecodedLayer,
  lightAt,
  staticFlags,
  type Vec3,
} from "@splatreel/decoder/internal";
import type { Scene } from "./scene";

/** Points of a file on the device. */
export interface UploadedPoints<Place = void> {
  readonly count: number;
  /** Set the flags [N] of `staticFlags`, for a layer. */
  setFlags(flags: Uint8Array, place: Place): void;
}

interface Group<T> extends Alive {
  points: T;
  light: Float32Array | null;
}

/** All loaded files. */
export abstract class UploadedFiles<T extends UploadedPoints<Place>, Place = void> {
  private readonly layers = new Map<string, T>();
  private readonly groups = new Map<number, Group<T>>();
  /** Scene for which the flags of static points were set. */
  private flagsKey = "";

  /** Upload the points of a file. */
  protected abstract upload(file: DecodedFile): T;

  /** Free the points of a file. */
  protected abstract free(points: T): void;

  addLayer(uri: string, file: DecodedLayer): T {
    const points = this.upload(file);
    this.layers.set(uri, points);
    this.flagsKey = "";
    return points;
  }

  /** layers: URIs of the layers that `alive` covers. */
  addGroup(index: number, file: DecodedGroup, layers: string[]): T {
    const points = this.upload(file);
    this.groups.set(index, { points, alive: file.alive, layers, light: file.light });
    this.flagsKey = "";
    return points;
  }

  dropGroup(index: number): void {
    const group = this.groups.get(index);
    this.groups.delete(index);
    if (group) this.free(group.points);
  }

  dropLayer(uri: string): void {
    const layer = this.layers.get(uri);
    this.layers.delete(uri);
    if (layer) this.free(layer);
  }

  /** Return true if all of a scene is uploaded. */
  holds({ current, previous, layers }: Scene): boolean {
    return (
      [current, previous].every((shown) => shown === null || this.groups.has(shown.group)) &&
      layers.every((uri) => this.layers.has(uri))
    );
  }

  /** Return the uploaded layers of a scene. */
  layersOf(scene: Scene): T[] {
    return scene.layers.flatMap((uri) => this.layers.get(uri) ?? []);
  }

  /** Return the points of a group; null if it is not uploaded. */
  group(index: number): T | null {
    return this.groups.get(index)?.points ?? null;
  }

  /** Return the red, green and blue factors of a scene's light, relative to its keyframe. */
  lightOf({ current }: Scene): Vec3 {
    return current ? lightAt(this.groups.get(current.group)!.light, current.frame) : [1, 1, 1];
  }

  /** Set which static points are alive in the groups of a scene. place: of the flags, if points have several. */
  flagStatics(scene: Scene, place: Place): void {
    const key = `${scene.layers} ${scene.current?.group} ${scene.previous?.group}`;
    if (key === this.flagsKey) return;
    this.flagsKey = key;
    const counts = new Map(scene.layers.map((uri) => [uri, this.layers.get(uri)?.count ?? 0]));
    const [now, before] = [scene.current, scene.previous].map((shown) => shown && this.groups.get(shown.group)!);
    for (const [uri, flags] of staticFlags(counts, now, before)) this.layers.get(uri)?.setFlags(flags, place);
  }

  /** Return the points of all files. */
  protected get all(): T[] {
    return [...this.layers.values(), ...[...this.groups.values()].map(({ points }) => points)];
  }
}
