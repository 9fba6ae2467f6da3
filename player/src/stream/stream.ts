/** Gets the files of a reel: what is wanted, in the order in which it is, as many at a time as there are workers. */
import { ReelError } from "../base/errors";
import type { DecodedFile } from "../decode/decode-file";
import { fileOf, sourceOf, type Manifest, type ReelFile } from "../reel/manifest";
import { Backoff } from "./backoff";
import type { DecoderPool, Job } from "./decoder-pool";
import { FileCache, costOf } from "./file-cache";
import { GroupRenditions } from "./group-renditions";
import { LoadProgress } from "./load-progress";
import { groupItem, isNeededNow, isOnScreen, itemOf, layerItem, queueOf, type Demand, type QueueItem } from "./queue";
import type { RenditionPolicy } from "./rendition-policy";

export interface StreamEvents {
  layer(index: number, file: DecodedFile): void;
  group(index: number, file: DecodedFile): void;
  dropped(group: number): void;
  /** Bytes came, or a file is being tried again: `trouble` says. */
  progress(): void;
  /** What shows now cannot be had; the stream has ended. */
  failed(error: Error): void;
}

export class Stream {
  /** Why something is late, for people; null while all is well. */
  trouble: string | null = null;

  private readonly cache: FileCache;
  private readonly renditions: GroupRenditions;
  private readonly backoff = new Backoff();
  private readonly wait = new LoadProgress();
  /** Renditions of the groups that are being got, by key. */
  private readonly coming = new Map<string, string>();
  private demand: Demand = { current: 0, previous: null, inUse: [], loop: false, frame: 0, rate: 1 };
  private stopped = false;

  /** budget: bytes that groups may take. */
  constructor(
    private manifest: Manifest,
    private readonly decoders: DecoderPool,
    private readonly budget: number,
    private readonly events: StreamEvents,
    policy: RenditionPolicy,
  ) {
    this.cache = new FileCache(manifest);
    this.renditions = new GroupRenditions(policy);
    decoders.whenFree(() => this.schedule());
  }

  /** A live reel has grown. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
    this.cache.update(manifest);
  }

  /** Layers that are complete from the first on. */
  get layersReady(): number {
    return this.cache.layersReady;
  }

  /** How many layers were born up to a group. */
  layersOf(group: number): number {
    return this.cache.layersOf(group);
  }

  /** Whether a group can be shown: with all layers that it needs. */
  has(group: number): boolean {
    return this.cache.canShow(group);
  }

  /** Files are being got. */
  get busy(): boolean {
    return this.decoders.keys.length > 0;
  }

  /** Of the bytes of what shows now and is not here yet, the part that came, 0..1. */
  get progress(): number {
    return this.wait.progress((key) => {
      const item = itemOf(key);
      const { bytes } = item.kind === "layer" ? this.manifest.layers[item.index] : this.fileOf(item.index);
      return { bytes, here: this.cache.holds(item) ? bytes : this.decoders.received(key) };
    });
  }

  /** Groups held, in order of time. */
  get held(): number[] {
    return this.cache.held;
  }

  /** The rendition that a group is here in; null where it is not, or where there is nothing to choose. */
  renditionOf(group: number): string | null {
    return this.cache.renditionOf(group) || null;
  }

  /** The file that a group is here in, or would be by default. */
  fileOf(group: number): ReelFile {
    return fileOf(this.manifest.groups[group], this.cache.renditionOf(group) ?? this.coming.get(groupItem(group).key) ?? "");
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    return this.cache.buffered;
  }

  /** Say what shows now. */
  want(demand: Demand): void {
    this.demand = demand;
    this.schedule();
  }

  /** Have this rendition from the next group on, or, with null, whichever does best. */
  choose(name: string | null): void {
    this.renditions.choose(name);
    this.schedule();
  }

  /** Tell whether the device draws what shows fast enough. */
  judge(slow: boolean): void {
    const { current } = this.demand;
    this.renditions.judge(slow, current, this.cache.renditionOf(current), this.manifest);
  }

  /** Give up what is not wanted any more, and have the workers get what is. */
  private schedule(): void {
    if (this.stopped) return;
    const queue = queueOf(this.manifest, this.demand, this.budget, (group) => this.costOf(group));
    this.cancelUnwanted(queue);
    this.noteWait(queue);
    let late = false;
    for (const item of queue) {
      const urgent = this.isNeededNow(item);
      // Layers have the whole line: there is something to see then.
      if (item.kind === "group" && this.layersAreComing()) return;
      // What shows gets the whole line.
      if (late && !urgent) return;
      if (this.cache.holds(item)) continue;
      late ||= urgent;
      if (this.decoders.has(item.key) || (!urgent && this.backoff.has(item.key))) continue;
      if (!this.decoders.free) {
        const leastUrgent = queue.findLast((other) => this.decoders.has(other.key) && !this.isNeededNow(other));
        if (urgent && leastUrgent) this.cancel(leastUrgent.key);
        return;
      }
      if (item.kind === "group" && !this.makeRoom(item, queue) && !urgent) return;
      this.load(item, item.kind === "group" ? this.renditionFor(item.index, this.decoders.meter.rate) : "");
    }
    if (late) return;
    this.makeRoom(null, queue); // what was on screen while another time was sought
    this.improve(queue);
  }

  private cancelUnwanted(queue: QueueItem[]): void {
    const keys = new Set(queue.map((item) => item.key));
    for (const key of this.decoders.keys) if (!keys.has(key)) this.cancel(key);
    // Another rendition of what is on screen by now comes too late.
    for (const item of queue) if (this.coming.has(item.key) && this.cache.holds(item) && isOnScreen(item.index, this.demand)) this.cancel(item.key);
  }

  /** Note what shows now and is not here. */
  private noteWait(queue: QueueItem[]): void {
    const needed = queue.filter((item) => this.isNeededNow(item));
    const keys = (items: QueueItem[]): string[] => items.map(({ key }) => key);
    this.wait.expect(keys(needed), keys(needed.filter((item) => !this.cache.holds(item))));
  }

  /** A layer that shows now has begun to come, and more than the next answer's time is missing of it. */
  private layersAreComing(): boolean {
    const { current } = this.demand;
    return this.manifest.layers.some(({ group }, index) => group <= current && !this.cache.holdsLayer(index) && !this.decoders.isNearlyHere(layerItem(index).key));
  }

  private isNeededNow(item: QueueItem): boolean {
    return isNeededNow(item, this.manifest, this.demand);
  }

  /** Drop groups that nobody needs until what is here fits, and `item` with it; false if it does not. */
  private makeRoom(item: QueueItem | null, queue: QueueItem[]): boolean {
    const sum = (groups: number[]): number => groups.reduce((total, group) => total + this.costOf(group), 0);
    const wanted = queue.filter(({ kind }) => kind === "group").map(({ index }) => index);
    const coming = queue.filter(({ key }) => this.coming.has(key)).map(({ index }) => index);
    // What is wanted may be more than the budget: the queue says when.
    const budget = Math.max(this.budget, sum(wanted));
    const room = budget - sum(item ? [...coming, item.index] : coming);
    const keep = (group: number): boolean => wanted.includes(group) || isOnScreen(group, this.demand);
    const { fits, dropped } = this.cache.makeRoom(room, this.demand.current, (group) => this.costOf(group), keep);
    for (const group of dropped) this.events.dropped(group);
    return fits;
  }

  private costOf(group: number): number {
    return costOf(this.fileOf(group));
  }

  private renditionFor(group: number, throughput: number): string {
    return this.renditions.renditionFor(group, this.manifest, this.demand, { throughput, decode: this.decoders.pace });
  }

  /** All that is wanted is here: get groups that do not show yet in the rendition that they should be in by now. */
  private improve(queue: QueueItem[]): void {
    if (this.manifest.renditions.length === 0 || queue.some((item) => !this.cache.holds(item))) return;
    // Nothing hangs on these transfers: they may find out that the line is better again.
    const throughput = this.decoders.meter.optimisticRate(performance.now());
    for (const item of queue) {
      const { kind, index, key } = item;
      if (!this.decoders.free) return;
      if (kind === "layer" || isOnScreen(index, this.demand) || this.decoders.has(key) || this.backoff.has(key)) continue;
      const name = this.renditionFor(index, throughput);
      if (this.renditions.isWorthReplacing(index, this.cache.renditionOf(index), name, this.manifest, this.demand, throughput)) this.load(item, name);
    }
  }

  private load(item: QueueItem, rendition: string): void {
    const { kind, index, key } = item;
    const file = kind === "layer" ? this.manifest.layers[index] : fileOf(this.manifest.groups[index], rendition);
    if (kind === "group") {
      this.coming.set(key, rendition);
      this.renditions.asked(rendition, this.manifest);
    }
    this.decoders.start(key, sourceOf(this.manifest, file), file.points, {
      received: (job) => {
        this.tell(null);
        if (kind === "group") this.reconsider(item, job);
        else if (this.decoders.isNearlyHere(key)) this.schedule();
      },
      trouble: (why) => this.tell(why),
      done: (decoded) => this.deliver(item, rendition, decoded),
      failed: (why, plain) => this.fail(item, new ReelError(why, { plain })),
    });
  }

  private cancel(key: string): void {
    this.coming.delete(key);
    this.decoders.cancel(key);
  }

  /** Give up the transfer of what is waited for, if less would be here much sooner. */
  private reconsider(item: QueueItem, job: Job): void {
    const { index, key } = item;
    if (!this.isNeededNow(item) || this.cache.holds(item)) return;
    if (!this.renditions.isTooSlow(index, this.coming.get(key), this.manifest, job)) return;
    this.renditions.downgrade(index);
    this.cancel(key);
    this.schedule();
  }

  private tell(trouble: string | null): void {
    this.trouble = trouble;
    this.events.progress();
  }

  /** The end where people wait for it; else it is tried again later. */
  private fail(item: QueueItem, error: ReelError): void {
    this.coming.delete(item.key);
    if (this.isNeededNow(item) && !(item.kind === "group" && this.cache.holds(item))) {
      this.stopped = true;
      this.events.failed(error);
    } else this.backoff.begin(item.key);
  }

  private deliver(item: QueueItem, rendition: string, file: DecodedFile): void {
    const { kind, index, key } = item;
    if (kind === "group") {
      this.coming.delete(key);
      this.renditions.arrived(index);
      if (this.cache.holds(item)) {
        if (isOnScreen(index, this.demand)) return; // it shows by now as it was
        this.events.dropped(index);
      }
    }
    this.cache.add(item, rendition);
    this.events[kind](index, file);
  }
}
