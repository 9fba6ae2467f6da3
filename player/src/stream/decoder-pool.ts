/** The workers that get and decode files, what each is at, and how fast that goes. */
import { PLAIN } from "../base/errors";
import type { DecodeReply, DecodeRequest } from "../decode/decode-worker";
import { decoderFiles, startDecodeWorker } from "../files/bundle";
import type { Source } from "../files/source";
import { failureOf } from "../files/workers";
import { BandwidthMeter } from "./bandwidth-meter";

/** Files that download and decode at a time. */
const WORKERS = 2;

/** What becomes of a file: bytes of it came, it is being tried again, it is here, or it cannot be had. */
export interface Receiver {
  received(job: Job): void;
  trouble(why: string): void;
  /** A `DecodedFile`, or the JSON of a page. */
  done(content: unknown): void;
  failed(why: string, plain?: string): void;
}

export interface Job {
  readonly source: Source;
  /** When it was asked for, milliseconds. */
  readonly asked: number;
  /** When its first byte came, milliseconds, and the bytes since then. */
  began: number;
  received: number;
}

interface Running extends Job {
  id: number;
  worker: Worker;
  /** Bytes are still expected. */
  open: boolean;
}

export class DecoderPool {
  readonly meter = new BandwidthMeter();
  /** Of the last file. */
  milliseconds = 0;
  /** Milliseconds a point, lately; 0: nothing was decoded yet. */
  pace = 0;
  private readonly workers: Worker[] = [];
  private readonly idle: Worker[] = [];
  private readonly running = new Map<string, Running>();
  private nextId = 0;
  private onfree: () => void = () => undefined;

  /** One worker starts at once, while the manifest is on its way; the other when two files are wanted. */
  constructor(worker?: Worker | null) {
    this.idle.push(this.addWorker(worker ?? startDecodeWorker()));
  }

  /** Have something called whenever a worker is free again. */
  whenFree(call: () => void): void {
    this.onfree = call;
  }

  get free(): boolean {
    return this.idle.length > 0 || this.workers.length < WORKERS;
  }

  /** Keys of the files being got. */
  get keys(): string[] {
    return [...this.running.keys()];
  }

  has(key: string): boolean {
    return this.running.has(key);
  }

  /** Bytes of a file that came so far. */
  received(key: string): number {
    return this.running.get(key)?.received ?? 0;
  }

  /** Whether the rest of a file will be here before the first byte of another one could: the rest takes less than a round trip. */
  isNearlyHere(key: string): boolean {
    const job = this.running.get(key);
    if (!job?.open) return true;
    const answer = job.began - job.asked;
    const rate = job.received / Math.max(performance.now() - job.began, answer, 1);
    return job.received > 0 && job.source.bytes - job.received < rate * answer;
  }

  /** Get a file of so many points, or a page (null). Only while a worker is free. */
  start(key: string, source: Source, points: number | null, receiver: Receiver): void {
    const worker = this.idle.pop() ?? this.addWorker();
    const job: Running = { id: this.nextId++, worker, source, asked: performance.now(), began: 0, received: 0, open: true };
    this.running.set(key, job);
    this.meter.begin(performance.now());
    const finish = (report: () => void, dead = false): void => {
      this.running.delete(key);
      this.close(job);
      this.release(worker, dead);
      report();
      this.onfree();
    };
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => {
      if (data.id !== job.id) return;
      if ("received" in data) {
        this.count(job, data.received);
        receiver.received(job);
      } else if ("trouble" in data) receiver.trouble(data.trouble);
      else if ("error" in data) finish(() => receiver.failed(data.error, data.plain));
      else {
        if (points !== null) this.time(data.milliseconds, points);
        finish(() => receiver.done(data.content));
      }
    };
    worker.onerror = (event) => finish(() => receiver.failed(`${source.url} cannot be decoded (${failureOf(event)}).`, PLAIN.player), true);
    send(worker, { id: job.id, source, page: points === null });
  }

  /** Give a file up. */
  cancel(key: string): void {
    const job = this.running.get(key);
    if (!job) return;
    const { worker } = job;
    this.running.delete(key);
    this.close(job);
    send(worker, { id: job.id, cancel: true });
    const free = (dead: boolean): void => {
      this.release(worker, dead);
      this.onfree();
    };
    // The worker is free once it has said so.
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => void (("content" in data || "error" in data) && free(false));
    worker.onerror = () => free(true);
  }

  destroy(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private addWorker(worker = startDecodeWorker()): Worker {
    this.workers.push(worker);
    send(worker, { files: decoderFiles() });
    return worker;
  }

  /** A worker is free again; another takes the place of a dead one when it is needed. */
  private release(worker: Worker, dead: boolean): void {
    if (!dead) return void this.idle.push(worker);
    worker.terminate();
    this.workers.splice(this.workers.indexOf(worker), 1);
  }

  private count(job: Running, bytes: number): void {
    const now = performance.now();
    if (job.received === 0) job.began = now;
    job.received += bytes;
    this.meter.came(bytes, now);
    if (job.received >= job.source.bytes) this.close(job); // what follows is decoding
  }

  private close(job: Running): void {
    if (job.open) this.meter.end(performance.now());
    job.open = false;
  }

  private time(milliseconds: number, points: number): void {
    this.milliseconds = milliseconds;
    if (points === 0) return;
    const pace = milliseconds / points;
    this.pace = this.pace === 0 ? pace : this.pace + 0.3 * (pace - this.pace);
  }
}

function send(worker: Worker, request: DecodeRequest): void {
  worker.postMessage(request);
}
