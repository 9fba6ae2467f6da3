/** Decides which files of a reel to have, and gets them: the layers first, then the group that shows, then those that follow. */
import { startWorker } from "./assets";
import type { DecodedFile } from "./decode";
import type { DecodeReply, DecodeRequest } from "./decode-worker";
import { ReelError } from "./errors";
import type { Manifest, ReelFile } from "./manifest";

/** Files that download and decode at a time. */
const WORKERS = 2;
/** Seconds to have ahead of the time that shows, if memory allows. */
const AHEAD = 8;
/** A file that could not be had, and that nobody waits for, is left alone for this many milliseconds. */
const REST = 10_000;

export interface StreamEvents {
  layer(index: number, file: DecodedFile): void;
  group(index: number, file: DecodedFile): void;
  dropped(group: number): void;
  /** Bytes came, or a file is being tried again: `trouble` says. */
  progress(): void;
  /** What shows now cannot be had; the stream has ended. */
  failed(error: Error): void;
}

/** What shows: the group, the one that fades out, the groups still on screen, and whether the first follows the last. */
export interface Demand {
  current: number;
  previous: number | null;
  inUse: number[];
  loop: boolean;
}

interface Wanted {
  kind: "layer" | "group";
  index: number;
  key: string;
}

interface Job {
  id: number;
  wanted: Wanted;
  worker: Worker;
  began: number;
  received: number;
}

export class Stream {
  /** Why something is late, for people; null while all is well. */
  trouble: string | null = null;
  /** Bits a second while downloading, and milliseconds a file took to decode: of the last files. */
  throughput = 0;
  decodeMilliseconds = 0;

  private readonly workers: Worker[];
  private readonly idle: Worker[];
  private readonly jobs = new Map<string, Job>();
  private readonly layers = new Set<number>();
  private readonly groups = new Set<number>();
  private readonly resting = new Map<string, number>();
  private demand: Demand = { current: 0, previous: null, inUse: [], loop: false };
  private nextId = 0;
  private stopped = false;

  /** budget: bytes that groups may take. */
  constructor(private readonly manifest: Manifest, private readonly budget: number, private readonly events: StreamEvents) {
    this.workers = Array.from({ length: WORKERS }, () => startWorker("decode-worker.js"));
    this.idle = [...this.workers];
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

  /** Groups held, in order of time. */
  get held(): number[] {
    return [...this.groups].sort((a, b) => a - b);
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

  /** Say what shows now. */
  want(demand: Demand): void {
    this.demand = demand;
    this.fill();
  }

  destroy(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private fill(): void {
    if (this.stopped) return;
    const queue = this.queue();
    const keys = new Set(queue.map((item) => item.key));
    for (const job of this.jobs.values()) if (!keys.has(job.wanted.key)) this.cancel(job);
    let late = false;
    for (const item of queue) {
      const urgent = this.isNeededNow(item);
      // What shows gets the whole line.
      if (late && !urgent) return;
      if ((item.kind === "layer" ? this.layers : this.groups).has(item.index)) continue;
      late ||= urgent;
      if (this.jobs.has(item.key) || (!urgent && (this.resting.get(item.key) ?? 0) > performance.now())) continue;
      if (this.idle.length === 0) {
        const leastUrgent = [...this.jobs.values()].find((job) => !this.isNeededNow(job.wanted));
        if (urgent && leastUrgent) this.cancel(leastUrgent);
        return;
      }
      if (item.kind === "group" && !this.makeRoom(item, queue) && !urgent) return;
      this.load(item);
    }
  }

  private isNeededNow({ kind, index }: Wanted): boolean {
    const { current, previous } = this.demand;
    return kind === "layer" ? this.manifest.layers[index].group <= current : index === current || index === previous;
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
    let room = this.budget - costOf(groups[current]) - (previous === null ? 0 : costOf(groups[previous]));
    let seconds = 0;
    for (let ahead = 1; ahead < groups.length && seconds < AHEAD; ahead++) {
      if (current + ahead >= groups.length && !loop) break;
      const index = (current + ahead) % groups.length;
      if (index === previous) continue;
      room -= costOf(groups[index]);
      // The next group is wanted however little memory there is: nothing would play without it.
      if (room < 0 && ahead > 1) break;
      result.push(...layers(current + 1, index), groupItem(index));
      seconds += groups[index].frames / fps;
    }
    return result;
  }

  /** Drop groups that nobody needs, those longest ago first, until one more fits; false if it does not. */
  private makeRoom(item: Wanted, queue: Wanted[]): boolean {
    const { groups } = this.manifest;
    const sum = (indices: number[]): number => indices.reduce((total, index) => total + costOf(groups[index]), 0);
    const groupsOf = (items: Wanted[]): number[] => items.filter(({ kind }) => kind === "group").map(({ index }) => index);
    const wanted = groupsOf(queue);
    // What is wanted may be more than the budget: the queue says when.
    const budget = Math.max(this.budget, sum(wanted));
    const loading = groupsOf([...this.jobs.values()].map((job) => job.wanted));
    let total = sum([...this.groups, ...loading, item.index]);
    const { current, inUse } = this.demand;
    const behind = (index: number): number => (current - index + groups.length) % groups.length;
    const victims = this.held.filter((index) => !wanted.includes(index) && !inUse.includes(index)).sort((a, b) => behind(a) - behind(b));
    while (total > budget && victims.length > 0) {
      const victim = victims.pop()!;
      total -= costOf(groups[victim]);
      this.groups.delete(victim);
      this.events.dropped(victim);
    }
    return total <= budget;
  }

  private load(wanted: Wanted): void {
    const worker = this.idle.pop()!;
    const job: Job = { id: this.nextId++, wanted, worker, began: performance.now(), received: 0 };
    this.jobs.set(wanted.key, job);
    const file = this.fileOf(wanted);
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => {
      if (data.id !== job.id) return;
      if ("received" in data) this.received(job, data.received);
      else if ("trouble" in data) this.troubled(data.trouble);
      else this.finish(job, () => ("file" in data ? this.deliver(job, data.file, data.milliseconds) : this.failed(wanted, data.error)));
    };
    worker.onerror = (event) => this.finish(job, () => this.failed(wanted, `${file.uri} cannot be decoded (${event.message}).`));
    const url = new URL(file.uri, this.manifest.url).href;
    this.tell(job, { id: job.id, source: { url, bytes: file.bytes, sha256: file.sha256 } });
  }

  private cancel(job: Job): void {
    this.jobs.delete(job.wanted.key);
    this.tell(job, { id: job.id, cancel: true });
    const free = (): void => {
      this.idle.push(job.worker);
      this.fill();
    };
    // The worker is free once it has said so.
    job.worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => void (("file" in data || "error" in data) && free());
    job.worker.onerror = free;
  }

  private finish(job: Job, deliver: () => void): void {
    this.jobs.delete(job.wanted.key);
    this.idle.push(job.worker);
    deliver();
    this.fill();
  }

  private received(job: Job, bytes: number): void {
    if (job.received === 0) job.began = performance.now();
    job.received += bytes;
    this.troubled(null);
  }

  private troubled(why: string | null): void {
    this.trouble = why;
    this.events.progress();
  }

  private failed(wanted: Wanted, why: string): void {
    if (this.isNeededNow(wanted)) {
      this.stopped = true;
      this.events.failed(new ReelError(why));
    } else this.resting.set(wanted.key, performance.now() + REST);
  }

  private deliver(job: Job, file: DecodedFile, milliseconds: number): void {
    const { kind, index } = job.wanted;
    const seconds = (performance.now() - job.began - milliseconds) / 1000;
    if (seconds > 0) this.throughput = (8 * job.received) / seconds;
    this.decodeMilliseconds = milliseconds;
    (kind === "layer" ? this.layers : this.groups).add(index);
    this.events[kind](index, file);
  }

  private fileOf({ kind, index }: Wanted): ReelFile {
    return (kind === "layer" ? this.manifest.layers : this.manifest.groups)[index];
  }

  private tell(job: Job, request: DecodeRequest): void {
    job.worker.postMessage(request);
  }
}

/** Bytes that a group takes once decoded: points and offsets on the GPU, positions and dx with the sort worker. */
export function costOf(group: ReelFile): number {
  return group.points * (92 + 20 * group.frames);
}

/** Bytes for groups on this device: an eighth of a gigabyte where nothing is known, more on larger machines. */
export function memoryBudget(): number {
  const gigabytes = (navigator as { deviceMemory?: number }).deviceMemory ?? 2;
  return Math.min(Math.max(gigabytes, 1), 8) * 2 ** 26;
}

function layerItem(index: number): Wanted {
  return { kind: "layer", index, key: `layer ${index}` };
}

function groupItem(index: number): Wanted {
  return { kind: "group", index, key: `group ${index}` };
}
