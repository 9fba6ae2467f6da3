/** Chooses the rendition of each group: the one that people chose, the smallest after a slow transfer, else that of the policy. */
import type { Manifest } from "../reel/manifest";
import { fileOf } from "../reel/reel-file";
import type { Job } from "./decoder-pool";
import { secondsTo, type Demand } from "./queue";
import type { Option, RenditionPolicy } from "./rendition-policy";

/** A transfer that playback waits for is replaced if the smallest rendition arrives this many times sooner, plus a second. */
const SPEEDUP = 2;

/** Throughput in bits per second and decoding time in milliseconds per point; 0 if unknown. */
export interface Pace {
  throughput: number;
  decode: number;
}

/** Renditions of the groups of one reel. */
export class GroupRenditions {
  /** The chosen rendition; null to adapt. */
  private choice: string | null = null;
  /** Groups whose transfer in a better rendition was cancelled. */
  private readonly downgraded = new Set<number>();
  /** Index of the last requested rendition. */
  private last: number | null = null;

  constructor(private readonly policy: RenditionPolicy) {}

  choose(name: string | null): void {
    this.choice = name;
  }

  /** Return the rendition to request, "" for a reel without renditions. */
  renditionFor(group: number, manifest: Manifest, demand: Demand, { throughput, decode }: Pace): string {
    const { renditions, groups, fps } = manifest;
    if (renditions.length === 0) return "";
    if (this.choice !== null) return this.choice;
    if (this.downgraded.has(group)) return renditions.at(-1)!;
    const seconds = groups[group].frames / fps / Math.max(demand.rate, 0.1);
    const ahead = secondsTo(group, manifest, demand);
    const found = this.policy.choose({
      options: optionsOf(group, manifest),
      seconds,
      ahead,
      throughput,
      decode,
      last: this.last,
    });
    return renditions[found];
  }

  /** Return true if a group in memory is worth replacing, and the transfer ends before it is shown. */
  isWorthReplacing(
    group: number,
    here: string | undefined,
    name: string,
    manifest: Manifest,
    demand: Demand,
    throughput: number,
  ): boolean {
    const place = (rendition: string | undefined): number => manifest.renditions.indexOf(rendition ?? "");
    const gain = place(here) - place(name);
    if (gain === 0 || (gain < 0 && this.choice === null)) return false;
    const transfer = (8 * fileOf(manifest.groups[group], name).bytes) / (throughput || 1);
    return SPEEDUP * transfer < secondsTo(group, manifest, demand);
  }

  /** Return true if the smallest rendition would arrive much sooner than the present transfer ends. */
  isTooSlow(group: number, coming: string | undefined, manifest: Manifest, { source, began, received }: Job): boolean {
    const least = manifest.renditions.at(-1);
    const elapsed = (performance.now() - began) / 1000;
    if (!least || this.choice !== null || coming === least || elapsed < 1) return false;
    const rate = received / elapsed;
    const smaller = fileOf(manifest.groups[group], least).bytes / rate;
    return (source.bytes - received) / rate >= SPEEDUP * smaller + 1;
  }

  /** Record a request. */
  recordRequest(name: string, { renditions }: Manifest): void {
    this.last = renditions.indexOf(name);
  }

  /** Request a group in the smallest rendition from now on. */
  downgrade(group: number): void {
    this.downgraded.add(group);
  }

  /** Forget the downgrade of a group that arrived. */
  arrived(group: number): void {
    this.downgraded.delete(group);
  }

  /** Report whether the device draws a group in its rendition too slowly. */
  judge(slow: boolean, group: number, here: string | undefined, manifest: Manifest): void {
    const shown = manifest.renditions.indexOf(here ?? "");
    if (shown >= 0) this.policy.judge(slow, optionsOf(group, manifest), shown, performance.now());
  }
}

function optionsOf(group: number, { renditions, groups }: Manifest): Option[] {
  return renditions.map((name) => fileOf(groups[group], name));
}
