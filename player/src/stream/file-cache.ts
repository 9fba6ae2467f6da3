/** Which layers and groups of a reel are here, in which rendition, and which go where memory is short. */
import type { Manifest } from "../reel/manifest";
import { layersAt, type ReelFile } from "../reel/reel-file";
import { firstFrameOf } from "../reel/timeline";
import type { QueueItem } from "./queue";

/** What went: groups by their numbers, layers by their uris. */
export interface Dropped {
  groups: number[];
  layers: string[];
}

export class FileCache {
  /** By their uris. */
  private readonly layers = new Map<string, ReelFile>();
  private readonly groups = new Map<number, { file: ReelFile; rendition: string }>();

  constructor(private manifest: Manifest) {}

  /** A live reel has grown, or a page is here. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
    // A layer may be retired that was not when it came.
    for (const layer of manifest.layers) if (this.layers.has(layer.uri)) this.layers.set(layer.uri, layer);
  }

  /** Whether a group can be shown: with all layers that it needs. */
  canShow(group: number): boolean {
    const file = this.manifest.groups[group];
    return Boolean(file) && this.groups.has(group) && layersAt(file).every(({ uri }) => this.layers.has(uri));
  }

  holds(item: QueueItem): boolean {
    if (item.kind === "page") return Boolean(this.manifest.groups[item.file.group]);
    return item.kind === "layer" ? this.layers.has(item.file.uri) : this.groups.has(item.index);
  }

  /** Groups held, in order of time. */
  get held(): number[] {
    return [...this.groups.keys()].sort((a, b) => a - b);
  }

  /** The file that a group is here in; undefined where it is not here. */
  fileOf(group: number): ReelFile | undefined {
    return this.groups.get(group)?.file;
  }

  /** The rendition that a group is here in, "" where there is nothing to choose; undefined where it is not here. */
  renditionOf(group: number): string | undefined {
    return this.groups.get(group)?.rendition;
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    const { manifest } = this;
    const ranges: [number, number][] = [];
    for (const index of this.held.filter((group) => group >= manifest.first && this.canShow(group))) {
      const start = manifest.groups[index].firstFrame / manifest.fps;
      const end = (firstFrameOf(manifest, index + 1) ?? manifest.frames) / manifest.fps;
      const last = ranges.at(-1);
      if (last && Math.abs(last[1] - start) < 1e-6) last[1] = end;
      else ranges.push([start, end]);
    }
    return ranges;
  }

  addLayer(file: ReelFile): void {
    this.layers.set(file.uri, file);
  }

  addGroup(group: number, file: ReelFile, rendition: string): void {
    this.groups.set(group, { file, rendition });
  }

  /**
   * Drop groups, those of before the reel's first and then those that showed longest ago, until what is here takes no more bytes
   * than `room`, and say whether it does. With the last group at which it lives goes a layer that is retired. keep: whether a group
   * has to stay. wanted: keys of the layers that do.
   */
  makeRoom(room: number, current: number, keep: (group: number) => boolean, wanted: Set<string>): Dropped & { fits: boolean } {
    const { first, groups: { length } } = this.manifest;
    const dropped: Dropped = { groups: [], layers: [] };
    const behind = (group: number): number => (group < first ? Infinity : (current - group + length - first) % (length - first));
    const victims = this.held.filter((group) => !keep(group)).sort((a, b) => behind(b) - behind(a));
    for (;;) {
      dropped.layers.push(...this.dropLayers(wanted));
      const fits = this.bytes <= room;
      if (victims.length === 0 || (fits && victims[0] >= first)) return { fits, ...dropped };
      const victim = victims.shift()!;
      this.groups.delete(victim);
      dropped.groups.push(victim);
    }
  }

  /** Those that are retired and live at no group that is here. */
  private dropLayers(wanted: Set<string>): string[] {
    const groups = [...this.groups.keys()];
    const gone = [...this.layers.values()].filter(({ uri, group, until }) => until < Infinity && !wanted.has(uri) && !groups.some((at) => group <= at && at < until));
    for (const { uri } of gone) this.layers.delete(uri);
    return gone.map(({ uri }) => uri);
  }

  private get bytes(): number {
    return [...this.layers.values(), ...[...this.groups.values()].map(({ file }) => file)].reduce((total, file) => total + costOf(file), 0);
  }
}

/** Bytes that a file takes once it is decoded: points and offsets on the GPU, positions and dx with the sort worker. Layers that stay are not counted. */
export function costOf({ points, frames, until }: Pick<ReelFile, "points" | "frames"> & { until?: number }): number {
  return frames === 0 && until === Infinity ? 0 : points * (92 + 24 * frames);
}

/** Bytes for groups on this device: an eighth of a gigabyte where nothing is known, more on larger machines. */
export function memoryBudget(): number {
  const gigabytes = (navigator as { deviceMemory?: number }).deviceMemory ?? 2;
  return Math.min(Math.max(gigabytes, 1), 8) * 2 ** 26;
}
