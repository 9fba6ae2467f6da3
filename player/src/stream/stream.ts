/** Decides which files of a reel to have, and in which rendition: the layers first, then the group that shows, then those that follow. */
import { ReelError } from "../base/errors";
import type { DecodedFile } from "../decode/decode-file";
import { fileOf, sourceOf, type Manifest, type ReelFile } from "../reel/manifest";
import type { DecoderPool, Job } from "./decoder-pool";
import { LoadProgress } from "./load-progress";
import { RenditionPolicy, type Option } from "./rendition-policy";

/** Seconds to have ahead of the time that shows, if memory allows. */
const AHEAD = 8;
/** A file that could not be had, and that nobody waits for, is left alone for this many milliseconds. */
const REST = 10_000;
/** A group that is waited for is taken in its smallest rendition if that is there so many times sooner, and a second. */
const SOONER = 2;

export interface StreamEvents {
  layer(index: number, file: DecodedFile): void;
  group(index: number, file: DecodedFile): void;
  dropped(group: number): void;
  /** Bytes came, or a file is being tried again: `trouble` says. */
  progress(): void;
  /** What shows now cannot be had; the stream has ended. */
  failed(error: Error): void;
}

/** What shows: the group, the one that fades out, the groups still on screen; whether the first follows the last; the frame and its rate. */
export interface Demand {
  current: number;
  previous: number | null;
  inUse: number[];
  loop: boolean;
  frame: number;
  rate: number;
}

interface Wanted {
  kind: "layer" | "group";
  index: number;
  key: string;
}

export class Stream {
  /** Why something is late, for people; null while all is well. */
  trouble: string | null = null;
  /** The rendition that people chose; null: whichever does best. */
  private choice: string | null = null;

  private readonly layers = new Set<number>();
  /** Groups that are here, by the rendition that they are here in. */
  private readonly groups = new Map<number, string>();
  /** Renditions of the groups that are being got, by key. */
  private readonly coming = new Map<string, string>();
  /** Groups that were given up in a better rendition. */
  private readonly hurried = new Set<number>();
  private readonly resting = new Map<string, number>();
  private readonly awaited = new LoadProgress();
  private demand: Demand = { current: 0, previous: null, inUse: [], loop: false, frame: 0, rate: 1 };
  private last: number | null = null;
  private stopped = false;

  /** budget: bytes that groups may take. */
  constructor(
    private manifest: Manifest,
    private readonly decoders: DecoderPool,
    private readonly budget: number,
    private readonly events: StreamEvents,
    private readonly chooser: RenditionPolicy,
  ) {
    decoders.whenFree(() => this.fill());
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

  has(group: number): boolean {
    return this.groups.has(group) && this.layersReady >= this.layersOf(group);
  }

  /** Files are being got. */
  get busy(): boolean {
    return this.decoders.keys.length > 0;
  }

  /** Of the bytes of what shows now and is not here yet, the part that came, 0..1. */
  get progress(): number {
    return this.awaited.progress((key) => {
      const item = itemOf(key);
      const { bytes } = item.kind === "layer" ? this.manifest.layers[item.index] : this.fileOf(item.index);
      return { bytes, here: this.isHere(item) ? bytes : this.decoders.received(key) };
    });
  }

  /** Groups held, in order of time. */
  get held(): number[] {
    return [...this.groups.keys()].sort((a, b) => a - b);
  }

  /** The rendition that a group is here in; null where it is not, or where there is nothing to choose. */
  renditionOf(group: number): string | null {
    return this.groups.get(group) || null;
  }

  /** The file that a group is here in, or would be by default. */
  fileOf(group: number): ReelFile {
    return fileOf(this.manifest.groups[group], this.groups.get(group) ?? this.coming.get(groupItem(group).key) ?? "");
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    const { groups, frames, fps } = this.manifest;
    const ranges: [number, number][] = [];
    for (const index of this.held.filter((group) => this.has(group))) {
      const start = groups[index].firstFrame / fps;
      const end = (groups[index + 1]?.firstFrame ?? frames) / fps;
      const last = ranges.at(-1);
      if (last && Math.abs(last[1] - start) < 1e-6) last[1] = end;
      else ranges.push([start, end]);
    }
    return ranges;
  }

  /** A live reel has grown. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
  }

  /** Say what shows now. */
  want(demand: Demand): void {
    this.demand = demand;
    this.fill();
  }

  /** Have this rendition from the next group on, or, with null, whichever does best. */
  choose(name: string | null): void {
    this.choice = name;
    this.fill();
  }

  /** Tell whether the device draws what shows fast enough. */
  judge(slow: boolean): void {
    const options = this.optionsOf(this.demand.current);
    const shown = this.manifest.renditions.findIndex(({ name }) => name === this.groups.get(this.demand.current));
    if (shown >= 0) this.chooser.judge(slow, options, shown, performance.now());
  }

  private fill(): void {
    if (this.stopped) return;
    const queue = this.queue();
    const keys = new Set(queue.map((item) => item.key));
    for (const key of this.decoders.keys) if (!keys.has(key)) this.cancel(key);
    // Another rendition of what is on screen by now comes too late.
    for (const { key, index } of queue) if (this.coming.has(key) && this.groups.has(index) && this.isOnScreen(index)) this.cancel(key);
    this.watch(queue);
    let late = false;
    for (const item of queue) {
      const urgent = this.isNeededNow(item);
      // Layers have the whole line: there is something to see then.
      if (item.kind === "group" && this.layersAreComing()) return;
      // What shows gets the whole line.
      if (late && !urgent) return;
      if (this.isHere(item)) continue;
      late ||= urgent;
      if (this.decoders.has(item.key) || (!urgent && this.rests(item))) continue;
      if (!this.decoders.free) {
        const leastUrgent = queue.findLast((other) => this.decoders.has(other.key) && !this.isNeededNow(other));
        if (urgent && leastUrgent) this.cancel(leastUrgent.key);
        return;
      }
      if (item.kind === "group" && !this.makeRoom(item, queue) && !urgent) return;
      this.load(item, item.kind === "group" ? this.renditionFor(item.index) : "");
    }
    if (late) return;
    this.makeRoom(null, queue); // what was on screen while another time was sought
    this.improve(queue);
  }

  /** Note what shows now and is not here. */
  private watch(queue: Wanted[]): void {
    const needed = queue.filter((item) => this.isNeededNow(item));
    const keys = (items: Wanted[]): string[] => items.map(({ key }) => key);
    this.awaited.expect(keys(needed), keys(needed.filter((item) => !this.isHere(item))));
  }

  /** A layer that shows now has begun to come, and more than the next answer's time is missing of it. */
  private layersAreComing(): boolean {
    const { layers } = this.manifest;
    return layers.some(({ group }, index) => group <= this.demand.current && !this.layers.has(index) && !this.decoders.isNearlyHere(layerItem(index).key));
  }

  private isHere({ kind, index }: Wanted): boolean {
    return (kind === "layer" ? this.layers : this.groups).has(index);
  }

  private isNeededNow({ kind, index }: Wanted): boolean {
    const { current, previous } = this.demand;
    return kind === "layer" ? this.manifest.layers[index].group <= current : index === current || index === previous;
  }

  private isOnScreen(group: number): boolean {
    const { current, previous, inUse } = this.demand;
    return group === current || group === previous || inUse.includes(group);
  }

  private rests({ key }: Wanted): boolean {
    return (this.resting.get(key) ?? 0) > performance.now();
  }

  /** What should be here, the most urgent first, as far as memory goes. */
  private queue(): Wanted[] {
    const { manifest, demand } = this;
    const { current, previous, loop } = demand;
    const { groups, fps } = manifest;
    const layers = (from: number, to: number): Wanted[] =>
      manifest.layers.flatMap((layer, index) => (layer.group >= from && layer.group <= to ? [layerItem(index)] : []));
    const result = [...layers(0, current), groupItem(current)];
    if (previous !== null) result.push(groupItem(previous));
    let room = this.budget - this.costOf(current) - (previous === null ? 0 : this.costOf(previous));
    let seconds = 0;
    for (let ahead = 1; ahead < groups.length && seconds < AHEAD; ahead++) {
      if (current + ahead >= groups.length && !loop) break;
      const index = (current + ahead) % groups.length;
      if (index === previous) continue;
      room -= this.costOf(index);
      // The next group is wanted however little memory there is: nothing would play without it.
      if (room < 0 && ahead > 1) break;
      result.push(...layers(current + 1, index), groupItem(index));
      seconds += groups[index].frames / fps;
    }
    return result;
  }

  /** Drop groups that nobody needs, those longest ago first, until what is here fits, and `item` with it; false if it does not. */
  private makeRoom(item: Wanted | null, queue: Wanted[]): boolean {
    const { groups } = this.manifest;
    const sum = (indices: number[]): number => indices.reduce((total, index) => total + this.costOf(index), 0);
    const wanted = queue.filter(({ kind }) => kind === "group").map(({ index }) => index);
    // What is wanted may be more than the budget: the queue says when.
    const budget = Math.max(this.budget, sum(wanted));
    const coming = queue.filter(({ key }) => this.coming.has(key)).map(({ index }) => index);
    let total = sum([...this.groups.keys(), ...coming, ...(item ? [item.index] : [])]);
    const { current } = this.demand;
    const behind = (index: number): number => (current - index + groups.length) % groups.length;
    const victims = this.held.filter((index) => !wanted.includes(index) && !this.isOnScreen(index)).sort((a, b) => behind(a) - behind(b));
    while (total > budget && victims.length > 0) {
      const victim = victims.pop()!;
      total -= this.costOf(victim);
      this.groups.delete(victim);
      this.events.dropped(victim);
    }
    return total <= budget;
  }

  private costOf(group: number): number {
    return costOf(this.fileOf(group));
  }

  private optionsOf(group: number): Option[] {
    const { renditions, groups } = this.manifest;
    return renditions.map(({ name }) => fileOf(groups[group], name));
  }

  /** Seconds until a group shows. */
  private secondsTo(group: number): number {
    const { groups, frames, fps } = this.manifest;
    const { frame, rate, current } = this.demand;
    const around = group < current ? frames : 0;
    return (groups[group].firstFrame + around - frame) / fps / Math.max(rate, 0.1);
  }

  /** The rendition to get a group in. */
  private renditionFor(group: number, throughput = this.decoders.meter.rate): string {
    const { renditions, groups, fps } = this.manifest;
    if (renditions.length === 0) return "";
    if (this.choice !== null) return this.choice;
    if (this.hurried.has(group)) return renditions.at(-1)!.name;
    const seconds = groups[group].frames / fps / Math.max(this.demand.rate, 0.1);
    const found = this.chooser.choose({
      options: this.optionsOf(group), seconds, ahead: this.secondsTo(group), throughput, decode: this.decoders.pace, last: this.last,
    });
    return renditions[found].name;
  }

  /** All that is wanted is here: get groups that do not show yet in the rendition that they should be in by now. */
  private improve(queue: Wanted[]): void {
    const { renditions, groups } = this.manifest;
    if (queue.some((item) => !this.isHere(item))) return;
    // Nothing hangs on these transfers: they may find out that the line is better again.
    const hope = this.decoders.meter.hope(performance.now());
    const place = (name: string | undefined): number => renditions.findIndex((rendition) => rendition.name === name);
    for (const item of renditions.length > 0 ? queue : []) {
      if (!this.decoders.free) return;
      if (item.kind === "layer" || this.isOnScreen(item.index) || this.decoders.has(item.key) || this.rests(item)) continue;
      const name = this.renditionFor(item.index, hope);
      const gain = place(this.groups.get(item.index)) - place(name);
      if (gain === 0 || (gain < 0 && this.choice === null)) continue;
      const transfer = (8 * fileOf(groups[item.index], name).bytes) / (hope || 1);
      if (SOONER * transfer < this.secondsTo(item.index)) this.load(item, name);
    }
  }

  private load(wanted: Wanted, rendition: string): void {
    const { kind, index, key } = wanted;
    const file = kind === "layer" ? this.manifest.layers[index] : fileOf(this.manifest.groups[index], rendition);
    if (kind === "group") {
      this.coming.set(key, rendition);
      this.last = this.manifest.renditions.findIndex(({ name }) => name === rendition);
    }
    this.decoders.start(key, sourceOf(this.manifest, file), file.points, {
      received: (job) => {
        this.troubled(null);
        if (kind === "group") this.reconsider(wanted, job);
        else if (this.decoders.isNearlyHere(key)) this.fill();
      },
      trouble: (why) => this.troubled(why),
      done: (decoded) => this.deliver(wanted, rendition, decoded),
      failed: (why, plain) => this.failed(wanted, new ReelError(why, { plain })),
    });
  }

  private cancel(key: string): void {
    this.coming.delete(key);
    this.decoders.cancel(key);
  }

  /** Give up the transfer of what is waited for, if less would be here much sooner. */
  private reconsider(wanted: Wanted, { source, began, received }: Job): void {
    const { index, key } = wanted;
    const least = this.manifest.renditions.at(-1)?.name;
    const elapsed = (performance.now() - began) / 1000;
    if (!least || this.choice !== null || this.coming.get(key) === least || elapsed < 1) return;
    if (!this.isNeededNow(wanted) || this.groups.has(index)) return;
    const rate = received / elapsed;
    const smaller = fileOf(this.manifest.groups[index], least).bytes / rate;
    if ((source.bytes - received) / rate < SOONER * smaller + 1) return;
    this.hurried.add(index);
    this.cancel(key);
    this.fill();
  }

  private troubled(why: string | null): void {
    this.trouble = why;
    this.events.progress();
  }

  private failed(wanted: Wanted, error: ReelError): void {
    this.coming.delete(wanted.key);
    if (this.isNeededNow(wanted) && !(wanted.kind === "group" && this.groups.has(wanted.index))) {
      this.stopped = true;
      this.events.failed(error);
    } else this.resting.set(wanted.key, performance.now() + REST);
  }

  private deliver({ kind, index, key }: Wanted, rendition: string, file: DecodedFile): void {
    if (kind === "layer") this.layers.add(index);
    else {
      this.coming.delete(key);
      this.hurried.delete(index);
      if (this.groups.has(index)) {
        if (this.isOnScreen(index)) return; // it shows by now as it was
        this.events.dropped(index);
      }
      this.groups.set(index, rendition);
    }
    this.events[kind](index, file);
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

function itemOf(key: string): Wanted {
  const [kind, index] = key.split(" ");
  return kind === "layer" ? layerItem(Number(index)) : groupItem(Number(index));
}

function layerItem(index: number): Wanted {
  return { kind: "layer", index, key: `layer ${index}` };
}

function groupItem(index: number): Wanted {
  return { kind: "group", index, key: `group ${index}` };
}
