/** The layers and groups of a reel in memory, their renditions, and which to drop when memory is short. */
import type { Manifest } from "../reel/manifest";
import type { Reel } from "../reel/reel";
import { layersAt, type ReelFile } from "../reel/reel-file";
import { firstFrameOf } from "../reel/timeline";
import type { QueueItem } from "./queue";

/** Dropped files: groups by number, layers by URI. */
export interface Dropped {
  groups: number[];
  layers: string[];
}

/** Keeps track of the files in memory. The decoded data itself is with the renderer and the sort worker. */
export class FileCache {
  /** By URI. */
  private readonly layers = new Map<string, ReelFile>();
  private readonly groups = new Map<number, { file: ReelFile; rendition: string }>();

  constructor(private readonly reel: Reel) {}

  /** Take over changes of the manifest: a layer that was kept forever may have been retired. */
  refresh(): void {
    for (const layer of this.manifest.layers) if (this.layers.has(layer.uri)) this.layers.set(layer.uri, layer);
  }

  private get manifest(): Manifest {
    return this.reel.manifest;
  }

  /** Return true if a group and all layers that it needs are in memory. */
  canShow(group: number): boolean {
    const file = this.manifest.groups[group];
    return Boolean(file) && this.groups.has(group) && layersAt(file).every(({ uri }) => this.layers.has(uri));
  }

  holds(item: QueueItem): boolean {
    if (item.kind === "page") return Boolean(this.manifest.groups[item.file.group]);
    return item.kind === "layer" ? this.layers.has(item.file.uri) : this.groups.has(item.index);
  }

  /** Groups in memory, in order of time. */
  get held(): number[] {
    return [...this.groups.keys()].sort((a, b) => a - b);
  }

  /** Return the file of a group in memory, of whichever rendition; undefined if there is none. */
  fileOf(group: number): ReelFile | undefined {
    return this.groups.get(group)?.file;
  }

  /** Return the rendition of a group in memory, "" for a reel without renditions; undefined if the group is not in memory. */
  renditionOf(group: number): string | undefined {
    return this.groups.get(group)?.rendition;
  }

  /** Time ranges whose groups can be shown, [start, end] in seconds. */
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
   * Drop groups until the files in memory take at most `room` bytes, and return whether they do. Groups before the reel's first go
   * first, then those shown longest ago. A retired layer goes with the last group at which it lives. keep: returns true for groups
   * that must stay. wanted: URIs of the layers that must stay.
   */
  makeRoom(
    room: number,
    current: number,
    keep: (group: number) => boolean,
    wanted: Set<string>,
  ): Dropped & { fits: boolean } {
    const {
      first,
      groups: { length },
    } = this.manifest;
    const dropped: Dropped = { groups: [], layers: [] };
    const behind = (group: number): number =>
      group < first ? Infinity : (current - group + length - first) % (length - first);
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

  /** Drop the retired layers that live at no group in memory. */
  private dropLayers(wanted: Set<string>): string[] {
    const groups = [...this.groups.keys()];
    const dropped = [...this.layers.values()].filter(
      ({ uri, group, until }) =>
        until < Infinity && !wanted.has(uri) && !groups.some((at) => group <= at && at < until),
    );
    for (const { uri } of dropped) this.layers.delete(uri);
    return dropped.map(({ uri }) => uri);
  }

  private get bytes(): number {
    return [...this.layers.values(), ...[...this.groups.values()].map(({ file }) => file)].reduce(
      (total, file) => total + costOf(file),
      0,
    );
  }
}

/** Return the bytes of memory of a decoded file: points and offsets on the GPU, positions and dx in the sort worker. Layers that are never retired count 0. */
export function costOf({ points, frames, until }: Pick<ReelFile, "points" | "frames"> & { until?: number }): number {
  return frames === 0 && until === Infinity ? 0 : points * (92 + 24 * frames);
}

/** Return the bytes of memory for groups: 64 MB per gigabyte of the device, 128 MB if the browser does not report it. */
export function memoryBudget(): number {
  const gigabytes = (globalThis.navigator as { deviceMemory?: number } | undefined)?.deviceMemory ?? 2;
  return Math.min(Math.max(gigabytes, 1), 8) * 2 ** 26;
}
