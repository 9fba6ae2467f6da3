/** Which rendition each group is got in: the one that people chose, the smallest where a better one came too slowly, else what the policy finds. */
import type { Manifest } from "../reel/manifest";
import { fileOf } from "../reel/reel-file";
import type { Job } from "./decoder-pool";
import { secondsTo, type Demand } from "./queue";
import type { Option, RenditionPolicy } from "./rendition-policy";

/** A group that is waited for is taken in its smallest rendition if that is there so many times sooner, and a second. */
const SOONER = 2;

/** How fast files come and are decoded: bits a second, milliseconds a point; 0: unknown. */
export interface Pace {
  throughput: number;
  decode: number;
}

export class GroupRenditions {
  /** The rendition that people chose; null: whichever does best. */
  private choice: string | null = null;
  /** Groups that were given up in a better rendition. */
  private readonly downgraded = new Set<number>();
  /** The place of the rendition that was taken last. */
  private last: number | null = null;

  constructor(private readonly policy: RenditionPolicy) {}

  choose(name: string | null): void {
    this.choice = name;
  }

  /** The rendition to get a group in, "" where there is one only. */
  renditionFor(group: number, manifest: Manifest, demand: Demand, { throughput, decode }: Pace): string {
    const { renditions, groups, fps } = manifest;
    if (renditions.length === 0) return "";
    if (this.choice !== null) return this.choice;
    if (this.downgraded.has(group)) return renditions.at(-1)!;
    const seconds = groups[group].frames / fps / Math.max(demand.rate, 0.1);
    const ahead = secondsTo(group, manifest, demand);
    const found = this.policy.choose({ options: optionsOf(group, manifest), seconds, ahead, throughput, decode, last: this.last });
    return renditions[found];
  }

  /** Whether a group that is here is worth getting again, and comes before it shows. */
  isWorthReplacing(group: number, here: string | undefined, name: string, manifest: Manifest, demand: Demand, throughput: number): boolean {
    const place = (rendition: string | undefined): number => manifest.renditions.indexOf(rendition ?? "");
    const gain = place(here) - place(name);
    if (gain === 0 || (gain < 0 && this.choice === null)) return false;
    const transfer = (8 * fileOf(manifest.groups[group], name).bytes) / (throughput || 1);
    return SOONER * transfer < secondsTo(group, manifest, demand);
  }

  /** Whether to give up the transfer of a group that is waited for, since the smallest rendition would be here much sooner. */
  isTooSlow(group: number, coming: string | undefined, manifest: Manifest, { source, began, received }: Job): boolean {
    const least = manifest.renditions.at(-1);
    const elapsed = (performance.now() - began) / 1000;
    if (!least || this.choice !== null || coming === least || elapsed < 1) return false;
    const rate = received / elapsed;
    const smaller = fileOf(manifest.groups[group], least).bytes / rate;
    return (source.bytes - received) / rate >= SOONER * smaller + 1;
  }

  /** A group is asked for in a rendition. */
  asked(name: string, { renditions }: Manifest): void {
    this.last = renditions.indexOf(name);
  }

  /** Get a group in the smallest rendition, until it is here. */
  downgrade(group: number): void {
    this.downgraded.add(group);
  }

  arrived(group: number): void {
    this.downgraded.delete(group);
  }

  /** Tell whether the device draws fast enough a group that is here in a rendition. */
  judge(slow: boolean, group: number, here: string | undefined, manifest: Manifest): void {
    const shown = manifest.renditions.indexOf(here ?? "");
    if (shown >= 0) this.policy.judge(slow, optionsOf(group, manifest), shown, performance.now());
  }
}

function optionsOf(group: number, { renditions, groups }: Manifest): Option[] {
  return renditions.map((name) => fileOf(groups[group], name));
}
