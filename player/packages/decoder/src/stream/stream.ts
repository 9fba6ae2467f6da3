/** Downloads the files of a reel in order of urgency, as many at a time as there are workers. */
import type { DecodedFile, DecodedGroup, DecodedLayer } from "../decode/decode-file";
import { fileOf, layersAt, type ReelFile } from "../reel/reel-file";
import { PLAIN, ReelError } from "../base/errors";
import { type Manifest, sourceOf } from "../reel/manifest";
import type { Page } from "../reel/pages";
import type { Reel } from "../reel/reel";
import type { DecoderPool, Job } from "./decoder-pool";
import { costOf, type Dropped, FileCache } from "./file-cache";
import { GroupRenditions } from "./group-renditions";
import { type Demand, groupKey, isOnScreen, type QueueItem, queueOf } from "./queue";
import type { RenditionPolicy } from "./rendition-policy";

/** Pause in milliseconds. */
const PAUSE = 10_000;

/** Remembers when each failed file may be requested again. */
class Backoff {
  private readonly until = new Map<string, number>();

  /** Begin the pause of a file that failed. */
  begin(key: string): void {
    this.until.set(key, performance.now() + PAUSE);
  }

  /** Return true during the pause of a file. */
  has(key: string): boolean {
    return (this.until.get(key) ?? 0) > performance.now();
  }
}

/** Return how a file contradicts its entry, such as a file of another group; null if it does not. kind: as listed. shDegree: highest degree of the reel. */
function contradictionOf(
  file: DecodedFile,
  entry: ReelFile,
  kind: DecodedFile["kind"],
  shDegree: number,
): string | null {
  if (file.kind !== kind) return `is a ${file.kind}; the manifest lists it as a ${kind}`;
  const found = [file.index, file.points.count, file.firstFrame, file.frames].join(", ");
  const told = [entry.group, entry.points, entry.firstFrame, entry.frames].join(", ");
  if (found !== told) return `has the group, points, first frame and frames ${found}; the manifest says ${told}`;
  if (file.points.shDegree > shDegree)
    return `has spherical harmonics of degree ${file.points.shDegree}, above the manifest's ${shDegree}`;
  if (file.kind === "layer") return null;
  const points = layersAt(entry).reduce((sum, layer) => sum + layer.points, 0);
  return file.alive.length === points
    ? null
    : `has flags of ${file.alive.length} static points; the layers that live at it hold ${points}`;
}

/** Returns the size of a file, by its key, and the bytes received. */
type Measure = (key: string) => { bytes: number; here: number };

/** Sums over all files of the present wait. */
export class LoadProgress {
  private readonly keys = new Set<string>();

  /** Set the needed and the missing files. Files that arrive during a wait count until none is missing. */
  expect(needed: string[], missing: string[]): void {
    if (missing.length === 0) this.keys.clear();
    for (const key of this.keys) if (!needed.includes(key)) this.keys.delete(key);
    for (const key of missing) this.keys.add(key);
  }

  /** Return the received part, 0 to 1. */
  progress(measure: Measure): number {
    const files = [...this.keys].map(measure);
    const total = files.reduce((sum, { bytes }) => sum + bytes, 0);
    return total > 0 ? files.reduce((sum, { bytes, here }) => sum + Math.min(here, bytes), 0) / total : 1;
  }
}

/** Layers of at most this many bytes download together: they take about as long as a round trip. */
const SMALL = 2 ** 15;

type LayerItem = Extract<QueueItem, { kind: "layer" }>;
type GroupItem = Extract<QueueItem, { kind: "group" }>;

/** Events of a stream. */
export interface StreamEvents {
  /** A layer was decoded. */
  layer(uri: string, file: DecodedLayer): void;
  /** A group was decoded. layers: URIs of the layers that live at the group. */
  group(index: number, file: DecodedGroup, layers: string[]): void;
  /** A page of the manifest arrived, as unchecked JSON. */
  page(page: Page, json: unknown): void;
  /** Files were dropped to free memory. */
  dropped(files: Dropped): void;
  /** A file is missing or differs from the manifest. Read the manifest again, and resolve to true if the reel was replaced. */
  outdated(): Promise<boolean>;
  /** Bytes arrived, or a transfer is retried; see `trouble`. */
  progress(): void;
  /** A file that is needed now cannot be downloaded. The stream has ended. */
  failed(error: Error): void;
}

/** Schedules downloads by the present demand. */
export class Stream {
  /** Reason for a delay, to show to people; null if there is none. */
  trouble: string | null = null;

  private readonly cache: FileCache;
  private readonly renditions: GroupRenditions;
  private readonly backoff = new Backoff();
  private readonly loadProgress = new LoadProgress();
  /** Renditions of the groups that are downloading, by key. */
  private readonly loading = new Map<string, string>();
  private demand: Demand = { current: null, previous: null, inUse: [], loop: false, frame: 0, rate: 1 };
  /** Files wanted by the last demand, most urgent first. */
  private queue: QueueItem[] = [];
  private stopped = false;

  /** budget: bytes of memory for groups and retired layers. */
  constructor(
    private readonly reel: Reel,
    private readonly decoders: DecoderPool,
    private readonly budget: number,
    private readonly events: StreamEvents,
    policy: RenditionPolicy,
  ) {
    this.cache = new FileCache(reel);
    this.renditions = new GroupRenditions(policy);
    decoders.whenFree(() => this.schedule());
  }

  /** Take over changes of the manifest. Call `want` afterwards. */
  refresh(): void {
    this.cache.refresh();
    const { current, previous } = this.demand;
    const dropped = [current, previous].some((group) => group !== null && !this.manifest.groups[group]);
    if (dropped) this.demand = { ...this.demand, current: null, previous: null };
  }

  /** Request no further files. */
  stop(): void {
    this.stopped = true;
  }

  private get manifest(): Manifest {
    return this.reel.manifest;
  }

  /** URIs of the layers that are needed now, up to the first one that is missing. */
  get loadedLayers(): string[] {
    const layers = this.queue.filter((item): item is LayerItem => item.kind === "layer" && item.urgent);
    const missing = layers.findIndex((item) => !this.cache.holds(item));
    return layers.slice(0, missing < 0 ? layers.length : missing).map(({ file }) => file.uri);
  }

  /** Return true if a group and all layers that it needs are in memory. */
  has(group: number): boolean {
    return this.cache.canShow(group);
  }

  /** True while files are downloading or decoding. */
  get busy(): boolean {
    return this.decoders.keys.length > 0;
  }

  /** Received part of the bytes that playback waits for, 0 to 1. */
  get progress(): number {
    if (this.queue.length === 0) return 0; // no demand yet
    return this.loadProgress.progress((key) => {
      const item = this.queue.find((other) => other.key === key)!;
      const { bytes } = item.kind === "group" ? this.fileOf(item.index) : item.file;
      return { bytes, here: this.cache.holds(item) ? bytes : this.decoders.received(key) };
    });
  }

  /** Groups in memory, in order of time. */
  get held(): number[] {
    return this.cache.held;
  }

  /** Return the rendition of a group in memory; null if it is not in memory or the reel has no renditions. */
  renditionOf(group: number): string | null {
    return this.cache.renditionOf(group) || null;
  }

  /** Return the file of a group in memory, else the one that is downloading, else that of the first rendition. */
  fileOf(group: number): ReelFile {
    return this.cache.fileOf(group) ?? fileOf(this.manifest.groups[group], this.loading.get(groupKey(group)) ?? "");
  }

  /** Time ranges whose groups can be shown, [start, end] in seconds. */
  get buffered(): [number, number][] {
    return this.cache.buffered;
  }

  /** Set what is shown now, and schedule its files. */
  want(demand: Demand): void {
    this.demand = demand;
    this.schedule();
  }

  /** Choose a rendition for the groups that follow; null: adapt to network and device. */
  choose(name: string | null): void {
    this.renditions.choose(name);
    if (this.queue.length > 0) this.schedule();
  }

  /** Report whether the device draws the present rendition too slowly. */
  judge(slow: boolean): void {
    const { current } = this.demand;
    if (current !== null) this.renditions.judge(slow, current, this.cache.renditionOf(current), this.manifest);
  }

  /** Cancel files that are no longer wanted and start those that are. */
  private schedule(): void {
    if (this.stopped) return;
    const queue = (this.queue = this.wanted());
    this.cancelUnwanted(queue);
    this.recordMissing(queue);
    let late = false;
    for (const item of queue) {
      const { urgent } = item;
      // Layers get the whole bandwidth, since they can be shown before the first group.
      if (item.kind === "group" && this.areLayersLoading()) return;
      // A large layer, too, since it can be shown before those that follow.
      if (item.kind === "layer" && urgent && this.isLayerLoadingBefore(item)) return;
      // So do the files that playback waits for.
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
    this.makeRoom(null, queue); // drop the groups that a seek kept on screen
    this.improve(queue);
  }

  private wanted(): QueueItem[] {
    return queueOf(this.manifest, this.demand, this.budget, (item) => this.costOf(item));
  }

  private cancelUnwanted(queue: QueueItem[]): void {
    const keys = new Set(queue.map((item) => item.key));
    for (const key of this.decoders.keys) if (!keys.has(key)) this.cancel(key);
    // A better rendition of a group that is already on screen is too late.
    for (const item of queue)
      if (
        item.kind === "group" &&
        this.loading.has(item.key) &&
        this.cache.holds(item) &&
        isOnScreen(item.index, this.demand)
      )
        this.cancel(item.key);
  }

  /** Record which needed files are missing, for `progress`. */
  private recordMissing(queue: QueueItem[]): void {
    const needed = queue.filter(({ urgent }) => urgent);
    const keys = (items: QueueItem[]): string[] => items.map(({ key }) => key);
    this.loadProgress.expect(keys(needed), keys(needed.filter((item) => !this.cache.holds(item))));
  }

  /** Return true while a needed layer downloads whose rest takes longer than one round trip. */
  private areLayersLoading(): boolean {
    return this.queue.some((item) => item.kind === "layer" && item.urgent && this.isLoading(item));
  }

  /** Return true while a large layer downloads that comes before a needed one. */
  private isLayerLoadingBefore({ key }: LayerItem): boolean {
    const earlier = this.queue.slice(
      0,
      this.queue.findIndex((item) => item.key === key),
    );
    return earlier.some((item) => item.kind === "layer" && item.file.bytes > SMALL && this.isLoading(item));
  }

  /** Return true if the rest of a file takes longer than one round trip. */
  private isLoading(item: QueueItem): boolean {
    return !this.cache.holds(item) && !this.decoders.isNearlyHere(item.key);
  }

  private isNeededNow({ key }: QueueItem): boolean {
    return this.queue.some((item) => item.urgent && item.key === key);
  }

  /** Drop unneeded files until the rest and `item` fit into memory. Returns false if they do not. */
  private makeRoom(item: QueueItem | null, queue: QueueItem[]): boolean {
    const sum = (items: QueueItem[]): number => items.reduce((total, each) => total + this.costOf(each), 0);
    const coming = queue.filter((other) => this.decoders.has(other.key) || other === item);
    // The queue may exceed the budget, for files that playback cannot do without.
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

  /** Once all wanted files are here, download groups that are not on screen yet in a better rendition. */
  private improve(queue: QueueItem[]): void {
    if (this.manifest.renditions.length === 0 || queue.some((item) => !this.cache.holds(item))) return;
    // Playback does not depend on these transfers, so they may probe whether the bandwidth has grown.
    const throughput = this.decoders.meter.optimisticRate(performance.now());
    for (const item of queue) {
      if (!this.decoders.free) return;
      if (
        item.kind !== "group" ||
        isOnScreen(item.index, this.demand) ||
        this.decoders.has(item.key) ||
        this.backoff.has(item.key)
      )
        continue;
      const { index } = item;
      const name = this.renditionFor(index, throughput);
      if (
        this.renditions.isWorthReplacing(
          index,
          this.cache.renditionOf(index),
          name,
          this.manifest,
          this.demand,
          throughput,
        )
      )
        this.load(item, name);
    }
  }

  private load(item: QueueItem, rendition: string): void {
    const { key } = item;
    const file = item.kind === "group" ? fileOf(item.file, rendition) : item.file;
    if (item.kind === "group") {
      this.loading.set(key, rendition);
      this.renditions.recordRequest(rendition, this.manifest);
    }
    this.decoders.start(key, sourceOf(this.manifest, file), "points" in file ? file.points : null, {
      received: (job) => {
        this.reportTrouble(null);
        if (item.kind === "group") this.reconsider(item, job);
        else if (this.decoders.isNearlyHere(key)) this.schedule();
      },
      trouble: (why) => this.reportTrouble(why),
      page: (json) => void (item.kind === "page" && this.events.page(item.file, json)),
      decoded: (decoded) => this.deliver(item, rendition, decoded),
      failed: (why, plain) => void this.fail(item, new ReelError(why, { plain })),
    });
  }

  private cancel(key: string): void {
    this.loading.delete(key);
    this.decoders.cancel(key);
  }

  /** Cancel a transfer that playback waits for, if a smaller rendition would arrive much sooner. */
  private reconsider(item: GroupItem, job: Job): void {
    const { index, key } = item;
    if (!this.isNeededNow(item) || this.cache.holds(item)) return;
    if (!this.renditions.isTooSlow(index, this.loading.get(key), this.manifest, job)) return;
    this.renditions.downgrade(index);
    this.cancel(key);
    this.schedule();
  }

  private reportTrouble(trouble: string | null): void {
    this.trouble = trouble;
    this.events.progress();
  }

  /** End the stream if playback waits for the file; otherwise retry the file later. */
  private async fail(item: QueueItem, error: ReelError): Promise<void> {
    this.loading.delete(item.key);
    if (!this.isNeededNow(item) || (item.kind === "group" && this.cache.holds(item)))
      return this.backoff.begin(item.key);
    this.stopped = true;
    if (error.plain === PLAIN.missing || error.plain === PLAIN.damaged) {
      if (await this.events.outdated()) return;
      // A live reel may have dropped the file, which then is not needed any more.
      if (this.manifest.live && !this.wanted().some(({ key, urgent }) => urgent && key === item.key)) {
        this.stopped = false;
        return this.schedule();
      }
    }
    this.events.failed(error);
  }

  private deliver(item: QueueItem, rendition: string, file: DecodedFile): void {
    if (item.kind === "page") return;
    const entry = item.kind === "group" ? fileOf(item.file, rendition) : item.file;
    const contradiction = contradictionOf(file, entry, item.kind, this.manifest.shDegree);
    if (contradiction) void this.fail(item, new ReelError(`${entry.uri} ${contradiction}.`));
    else if (item.kind === "group") this.deliverGroup(item, rendition, file as DecodedGroup);
    else {
      this.cache.addLayer(item.file);
      this.events.layer(item.file.uri, file as DecodedLayer);
    }
  }

  private deliverGroup(item: GroupItem, rendition: string, file: DecodedGroup): void {
    const { index, key } = item;
    this.loading.delete(key);
    this.renditions.arrived(index);
    if (this.cache.holds(item)) {
      if (isOnScreen(index, this.demand)) return; // the earlier rendition is already on screen
      this.events.dropped({ groups: [index], layers: [] });
    }
    this.cache.addGroup(index, fileOf(item.file, rendition), rendition);
    this.events.group(
      index,
      file,
      layersAt(item.file).map(({ uri }) => uri),
    );
  }
}
