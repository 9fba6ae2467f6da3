/** Decides which files of a reel to have, and gets them: the layers first, then the group that shows, then the next. */
import { startWorker } from "./assets";
import type { DecodedFile } from "./decode";
import type { DecodeRequest } from "./decode-worker";
import { ReelError } from "./errors";
import type { Manifest, ReelFile } from "./manifest";

/** Files that download and decode at a time. */
const WORKERS = 2;
/** Groups to have ahead of the one that shows. */
const AHEAD = 1;

export interface StreamEvents {
  layer(index: number, file: DecodedFile): void;
  group(index: number, file: DecodedFile): void;
  dropped(group: number): void;
  failed(error: Error): void;
}

interface Wanted {
  kind: "layer" | "group";
  index: number;
}

export class Stream {
  private readonly workers: Worker[];
  private readonly idle: Worker[];
  private readonly loading = new Map<string, Wanted>();
  private readonly layers = new Set<number>();
  private readonly groups = new Set<number>();
  private current = 0;
  private previous: number | null = null;
  private inUse: number[] = [];
  /** Files that could not be had, until `retry`; they matter once they are needed. */
  private readonly failures = new Map<string, Error>();
  private nextId = 0;

  /** slots: groups that may be held at a time. */
  constructor(private readonly manifest: Manifest, private readonly slots: number, private readonly events: StreamEvents) {
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

  /** Say what shows now: the group, the one that fades out, and the groups that are still on screen. */
  want(current: number, previous: number | null, inUse: number[]): void {
    this.current = current;
    this.previous = previous;
    this.inUse = inUse;
    this.fill();
  }

  /** Try again after an error. */
  retry(): void {
    this.failures.clear();
    this.fill();
  }

  destroy(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private fill(): void {
    for (const wanted of this.queue()) {
      const key = `${wanted.kind} ${wanted.index}`;
      const failure = this.failures.get(key);
      if (failure) {
        if (this.isNeededNow(wanted)) {
          this.events.failed(failure);
          return;
        }
        continue;
      }
      if (this.idle.length === 0) return;
      if (this.loading.has(key) || (wanted.kind === "layer" ? this.layers : this.groups).has(wanted.index)) continue;
      if (wanted.kind === "group" && !this.makeRoom()) continue;
      this.load(wanted, key);
    }
  }

  private isNeededNow({ kind, index }: Wanted): boolean {
    if (kind === "layer") return this.manifest.layers[index].group <= this.current;
    return index === this.current || index === this.previous;
  }

  /** What should be here, the most urgent first. */
  private queue(): Wanted[] {
    const { current, previous } = this;
    const last = this.manifest.groups.length - 1;
    const layers = (from: number, to: number): Wanted[] =>
      this.manifest.layers.flatMap((layer, index) => (layer.group >= from && layer.group <= to ? [{ kind: "layer", index }] : []));
    const result = layers(0, current);
    result.push({ kind: "group", index: current });
    if (previous !== null) result.push({ kind: "group", index: previous });
    for (let ahead = 1; ahead <= AHEAD; ahead++) {
      // After the last group comes the first again.
      const index = current + ahead <= last ? current + ahead : current + ahead - last - 1;
      if (index !== current) result.push(...layers(current + 1, index), { kind: "group", index });
    }
    return result;
  }

  /** Drop a group nobody needs if all slots are taken; false if none can go. */
  private makeRoom(): boolean {
    const loading = [...this.loading.values()].filter((item) => item.kind === "group").length;
    if (this.groups.size + loading < this.slots) return true;
    const needed = new Set([...this.inUse, ...this.queue().filter((item) => item.kind === "group").map((item) => item.index)]);
    const victim = this.held.find((index) => !needed.has(index));
    if (victim === undefined) return false;
    this.groups.delete(victim);
    this.events.dropped(victim);
    return true;
  }

  private load(wanted: Wanted, key: string): void {
    const worker = this.idle.pop()!;
    this.loading.set(key, wanted);
    const file: ReelFile = (wanted.kind === "layer" ? this.manifest.layers : this.manifest.groups)[wanted.index];
    const finish = (deliver: () => void): void => {
      this.loading.delete(key);
      this.idle.push(worker);
      deliver();
      this.fill();
    };
    worker.onmessage = ({ data }: MessageEvent<{ file?: DecodedFile; error?: string }>) => finish(() => {
      if (data.file) this.deliver(wanted, data.file);
      else this.failures.set(key, new ReelError(data.error ?? "A file could not be decoded."));
    });
    worker.onerror = (event) => finish(() => void this.failures.set(key, new ReelError(`${file.uri} cannot be decoded (${event.message}).`)));
    const request: DecodeRequest = { id: this.nextId++, url: new URL(file.uri, this.manifest.url).href, bytes: file.bytes };
    worker.postMessage(request);
  }

  private deliver({ kind, index }: Wanted, file: DecodedFile): void {
    if (kind === "layer") {
      this.layers.add(index);
      this.events.layer(index, file);
    } else {
      this.groups.add(index);
      this.events.group(index, file);
    }
  }
}
