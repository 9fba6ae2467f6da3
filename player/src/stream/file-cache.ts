/** Which layers and groups of a reel are here, in which rendition, and which groups go where memory is short. */
import type { Manifest, ReelFile } from "../reel/manifest";
import type { QueueItem } from "./queue";

export class FileCache {
  private readonly layers = new Set<number>();
  /** Groups by the rendition that they are here in. */
  private readonly groups = new Map<number, string>();

  constructor(private manifest: Manifest) {}

  /** A live reel has grown. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
  }

  /** Layers that are complete from the first on. */
  get layersReady(): number {
    let count = 0;
    while (this.layers.has(count)) count++;
    return count;
  }

  /** How many layers were born up to a group. */
  layersOf(group: number): number {
    return this.manifest.layers.filter((layer) => layer.group <= group).length;
  }

  /** Whether a group can be shown: with all layers that it needs. */
  canShow(group: number): boolean {
    return this.groups.has(group) && this.layersReady >= this.layersOf(group);
  }

  holdsLayer(index: number): boolean {
    return this.layers.has(index);
  }

  holds({ kind, index }: QueueItem): boolean {
    return (kind === "layer" ? this.layers : this.groups).has(index);
  }

  /** Groups held, in order of time. */
  get held(): number[] {
    return [...this.groups.keys()].sort((a, b) => a - b);
  }

  /** The rendition that a group is here in, "" where there is nothing to choose; undefined where it is not here. */
  renditionOf(group: number): string | undefined {
    return this.groups.get(group);
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    const { groups, frames, fps } = this.manifest;
    const ranges: [number, number][] = [];
    for (const index of this.held.filter((group) => this.canShow(group))) {
      const start = groups[index].firstFrame / fps;
      const end = (groups[index + 1]?.firstFrame ?? frames) / fps;
      const last = ranges.at(-1);
      if (last && Math.abs(last[1] - start) < 1e-6) last[1] = end;
      else ranges.push([start, end]);
    }
    return ranges;
  }

  add({ kind, index }: QueueItem, rendition: string): void {
    if (kind === "layer") this.layers.add(index);
    else this.groups.set(index, rendition);
  }

  /**
   * Drop groups, those that showed longest ago first, until those that are here take no more bytes than `room`, and say whether they do.
   * keep: whether a group has to stay.
   */
  makeRoom(room: number, current: number, costOf: (group: number) => number, keep: (group: number) => boolean): { fits: boolean; dropped: number[] } {
    let total = 0;
    for (const group of this.groups.keys()) total += costOf(group);
    const dropped: number[] = [];
    if (total <= room) return { fits: true, dropped };
    const { length } = this.manifest.groups;
    const behind = (group: number): number => (current - group + length) % length;
    const victims = this.held.filter((group) => !keep(group)).sort((a, b) => behind(b) - behind(a));
    for (const victim of victims) {
      if (total <= room) break;
      total -= costOf(victim);
      this.groups.delete(victim);
      dropped.push(victim);
    }
    return { fits: total <= room, dropped };
  }
}

/** Bytes that a group takes once decoded: points and offsets on the GPU, positions and dx with the sort worker. */
export function costOf(group: Pick<ReelFile, "points" | "frames">): number {
  return group.points * (92 + 24 * group.frames);
}

/** Bytes for groups on this device: an eighth of a gigabyte where nothing is known, more on larger machines. */
export function memoryBudget(): number {
  const gigabytes = (navigator as { deviceMemory?: number }).deviceMemory ?? 2;
  return Math.min(Math.max(gigabytes, 1), 8) * 2 ** 26;
}
