/** Gets the files of a reel: what is wanted, in the order in which it is, as many at a time as there are workers. */
import { PLAIN, ReelError } from "../base/errors";
import type { DecodedFile } from "../decode/decode-file";
import { sourceOf, type Manifest } from "../reel/manifest";
import type { Page } from "../reel/pages";
import { fileOf, layersAt, type ReelFile } from "../reel/reel-file";
import { Backoff } from "./backoff";
import type { DecoderPool, Job } from "./decoder-pool";
import { FileCache, costOf, type Dropped } from "./file-cache";
import { GroupRenditions } from "./group-renditions";
import { LoadProgress } from "./load-progress";
import { groupKey, isOnScreen, queueOf, type Demand, type QueueItem } from "./queue";
import type { RenditionPolicy } from "./rendition-policy";

type LayerItem = Extract<QueueItem, { kind: "layer" }>;
type GroupItem = Extract<QueueItem, { kind: "group" }>;

export interface StreamEvents {
  layer(uri: string, file: DecodedFile): void;
  /** layers: the uris of those that live at the group. */
  group(index: number, file: DecodedFile, layers: string[]): void;
  /** What a page of the manifest says, unchecked. */
  page(page: Page, json: unknown): void;
  dropped(what: Dropped): void;
  /** A file is gone, or not what the manifest says. Resolves once the manifest was read again: true, if the reel is another one by now. */
  outdated(): Promise<boolean>;
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
  private demand: Demand = { current: null, previous: null, inUse: [], loop: false, frame: 0, rate: 1 };
  /** What is wanted, by the last demand. */
  private queue: QueueItem[] = [];
  private stopped = false;

  /** budget: bytes that groups may take, and layers that are retired again. */
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

  /** A live reel has grown, or a page is here. Then `want` has to be called. */
  update(manifest: Manifest): void {
    this.manifest = manifest;
    this.cache.update(manifest);
    const { current, previous } = this.demand;
    const dropped = [current, previous].some((group) => group !== null && !manifest.groups[group]);
    if (dropped) this.demand = { ...this.demand, current: null, previous: null };
  }

  /** The uris of the layers that show now, as many as are complete from the first on. */
  get layersHere(): string[] {
    const layers = this.queue.filter((item): item is LayerItem => item.kind === "layer" && item.urgent);
    const missing = layers.findIndex((item) => !this.cache.holds(item));
    return layers.slice(0, missing < 0 ? layers.length : missing).map(({ file }) => file.uri);
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
    if (this.queue.length === 0) return 0; // nothing was asked for yet
    return this.wait.progress((key) => {
      const item = this.queue.find((other) => other.key === key)!;
      const { bytes } = item.kind === "group" ? this.fileOf(item.index) : item.file;
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
    return this.cache.fileOf(group) ?? fileOf(this.manifest.groups[group], this.coming.get(groupKey(group)) ?? "");
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
    if (this.queue.length > 0) this.schedule();
  }

  /** Tell whether the device draws what shows fast enough. */
  judge(slow: boolean): void {
    const { current } = this.demand;
    if (current !== null) this.renditions.judge(slow, current, this.cache.renditionOf(current), this.manifest);
  }

  /** Give up what is not wanted any more, and have the workers get what is. */
  private schedule(): void {
    if (this.stopped) return;
    const queue = (this.queue = this.wanted());
    this.cancelUnwanted(queue);
    this.noteWait(queue);
    let late = false;
    for (const item of queue) {
      const { urgent } = item;
      // Layers have the whole line: there is something to see then.
      if (item.kind === "group" && this.layersAreComing()) return;
      // What shows gets the whole line.
      if (late && !urgent) return;
      if (this.cache.holds(item)) continue;
      late ||= urgent;
      if (this.decoders.has(item.key) || (!urgent && this.backoff.has(item.key))) continue;
      if (!this.decoders.free) {
        const leastUrgent = queue.findLast((other) => this.decoders.has(other.key) && !other.urgent);
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

  private wanted(): QueueItem[] {
    return queueOf(this.manifest, this.demand, this.budget, (item) => this.costOf(item));
  }

  private cancelUnwanted(queue: QueueItem[]): void {
    const keys = new Set(queue.map((item) => item.key));
    for (const key of this.decoders.keys) if (!keys.has(key)) this.cancel(key);
    // Another rendition of what is on screen by now comes too late.
    for (const item of queue) if (item.kind === "group" && this.coming.has(item.key) && this.cache.holds(item) && isOnScreen(item.index, this.demand)) this.cancel(item.key);
  }

  /** Note what shows now and is not here. */
  private noteWait(queue: QueueItem[]): void {
    const needed = queue.filter(({ urgent }) => urgent);
    const keys = (items: QueueItem[]): string[] => items.map(({ key }) => key);
    this.wait.expect(keys(needed), keys(needed.filter((item) => !this.cache.holds(item))));
  }

  /** A layer that shows now has begun to come, and more than the next answer's time is missing of it. */
  private layersAreComing(): boolean {
    return this.queue.some((item) => item.kind === "layer" && item.urgent && !this.cache.holds(item) && !this.decoders.isNearlyHere(item.key));
  }

  private isNeededNow({ key }: QueueItem): boolean {
    return this.queue.some((item) => item.urgent && item.key === key);
  }

  /** Drop what nobody needs until what is here fits, and `item` with it; false if it does not. */
  private makeRoom(item: QueueItem | null, queue: QueueItem[]): boolean {
    const sum = (items: QueueItem[]): number => items.reduce((total, each) => total + this.costOf(each), 0);
    const coming = queue.filter((other) => this.decoders.has(other.key) || other === item);
    // What is wanted may be more than the budget: the queue says when.
    const room = Math.max(this.budget, sum(queue)) - sum(coming);
    const keys = new Set(queue.map(({ key }) => key));
    const keep = (group: number): boolean => keys.has(groupKey(group)) || isOnScreen(group, this.demand);
    const layers = new Set(queue.flatMap((other) => (other.kind === "layer" ? other.file.uri : [])));
    const { fits, ...dropped } = this.cache.makeRoom(room, this.demand.current ?? 0, keep, layers);
    if (dropped.groups.length + dropped.layers.length > 0) this.events.dropped(dropped);
    return fits;
  }

  private costOf(item: QueueItem): number {
    return item.kind === "page" ? 0 : costOf(item.kind === "group" ? this.fileOf(item.index) : item.file);
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
      if (!this.decoders.free) return;
      if (item.kind !== "group" || isOnScreen(item.index, this.demand) || this.decoders.has(item.key) || this.backoff.has(item.key)) continue;
      const { index } = item;
      const name = this.renditionFor(index, throughput);
      if (this.renditions.isWorthReplacing(index, this.cache.renditionOf(index), name, this.manifest, this.demand, throughput)) this.load(item, name);
    }
  }

  private load(item: QueueItem, rendition: string): void {
    const { key } = item;
    const file = item.kind === "group" ? fileOf(item.file, rendition) : item.file;
    if (item.kind === "group") {
      this.coming.set(key, rendition);
      this.renditions.asked(rendition, this.manifest);
    }
    this.decoders.start(key, sourceOf(this.manifest, file), "points" in file ? file.points : null, {
      received: (job) => {
        this.tell(null);
        if (item.kind === "group") this.reconsider(item, job);
        else if (this.decoders.isNearlyHere(key)) this.schedule();
      },
      trouble: (why) => this.tell(why),
      done: (content) => (item.kind === "page" ? this.events.page(item.file, content) : this.deliver(item, rendition, content as DecodedFile)),
      failed: (why, plain) => void this.fail(item, new ReelError(why, { plain })),
    });
  }

  private cancel(key: string): void {
    this.coming.delete(key);
    this.decoders.cancel(key);
  }

  /** Give up the transfer of what is waited for, if less would be here much sooner. */
  private reconsider(item: GroupItem, job: Job): void {
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
  private async fail(item: QueueItem, error: ReelError): Promise<void> {
    this.coming.delete(item.key);
    if (!this.isNeededNow(item) || (item.kind === "group" && this.cache.holds(item))) return this.backoff.begin(item.key);
    this.stopped = true;
    if (error.plain === PLAIN.missing || error.plain === PLAIN.damaged) {
      if (await this.events.outdated()) return;
      // What was dropped from the reel does not show any more.
      if (this.manifest.live && !this.wanted().some(({ key, urgent }) => urgent && key === item.key)) {
        this.stopped = false;
        return this.schedule();
      }
    }
    this.events.failed(error);
  }

  private deliver(item: LayerItem | GroupItem, rendition: string, file: DecodedFile): void {
    if (item.kind === "layer") {
      this.cache.addLayer(item.file);
      return this.events.layer(item.file.uri, file);
    }
    const { index, key } = item;
    this.coming.delete(key);
    this.renditions.arrived(index);
    if (this.cache.holds(item)) {
      if (isOnScreen(index, this.demand)) return; // it shows by now as it was
      this.events.dropped({ groups: [index], layers: [] });
    }
    this.cache.addGroup(index, fileOf(item.file, rendition), rendition);
    this.events.group(index, file, layersAt(item.file).map(({ uri }) => uri));
  }
}
