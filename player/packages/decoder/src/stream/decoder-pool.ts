/** Workers that download and decode files, their jobs, and their speed. */
import { messageOf, PLAIN } from "../base/errors";
import type { DecodedFile } from "../decode/decode-file";
import type { DecodeReply, DecodeRequest } from "../decode/decode-worker";
import { requestOf, type Source } from "../files/source";
import { failureOf, type FileAddresses } from "../files/workers";

/** A sample ends after this many bits or seconds. The last few samples are averaged. */
const BITS = 2 ** 18;
const SECONDS = 0.25;
const SAMPLES = 5;
/** Age in seconds at which a sample is discarded. */
const AGE = 10;
/** Seconds without requests after which the optimistic rate doubles. */
const DOUBT = 5;

/** Average over the last samples. */
export class BandwidthMeter {
  private samples: { bits: number; seconds: number; now: number }[] = [];
  private bits = 0;
  private seconds = 0;
  private active = 0;
  private last = 0;

  /** Bits per second; 0 before the first sample. */
  get rate(): number {
    const sum = (key: "bits" | "seconds"): number => this.samples.reduce((total, sample) => total + sample[key], 0);
    const seconds = sum("seconds");
    return seconds > 0 ? sum("bits") / seconds : 0;
  }

  /** Return the rate, increased for the time without requests. now: milliseconds. */
  optimisticRate(now: number): number {
    return this.rate * (this.active > 0 ? 1 : 2 ** ((now - this.last) / 1000 / DOUBT));
  }

  /** Count a request as open. now: milliseconds. */
  begin(now: number): void {
    this.addTime(now);
    this.active++;
  }

  /** Count a request as closed. */
  end(now: number): void {
    this.addTime(now);
    this.active--;
  }

  /** Add received bytes. */
  addBytes(bytes: number, now: number): void {
    this.addTime(now);
    this.bits += 8 * bytes;
    if (this.seconds <= 0 || (this.bits < BITS && this.seconds < SECONDS)) return;
    this.samples.push({ bits: this.bits, seconds: this.seconds, now });
    this.samples = this.samples.slice(-SAMPLES).filter((sample) => now - sample.now < 1000 * AGE);
    [this.bits, this.seconds] = [0, 0];
  }

  private addTime(now: number): void {
    if (this.active > 0) this.seconds += (now - this.last) / 1000;
    this.last = now;
  }
}

/** Maximum number of files that download and decode at the same time. */
const WORKERS = 2;

/** Starts decode workers. Only the page or program knows where their files are. */
export interface DecodeWorkers {
  /** Start a worker. */
  start(): Worker;
  /** Return the addresses of the files that a worker loads. */
  files(): FileAddresses;
}

/** A worker that a page started before it had a pool, and the file that it asked the worker for; null for none. */
export interface EarlyWorker {
  worker: Worker;
  file: EarlyFile | null;
}

/** Number of the request for an early file. */
export const EARLY = -1;

/** A file that was requested early, and the replies so far with their times in milliseconds. */
export interface EarlyFile {
  url: string;
  replies: { data: DecodeReply; at: number }[];
}

/** Events of one job. */
export interface Receiver {
  /** More bytes arrived. */
  received(job: Job): void;
  /** The transfer is retried. */
  trouble(why: string): void;
  /** A layer or group was decoded. */
  decoded(file: DecodedFile): void;
  /** A page arrived, as unchecked JSON. */
  page(json: unknown): void;
  failed(why: string, plain?: string): void;
}

/** A file being downloaded and decoded. */
export interface Job {
  readonly source: Source;
  /** Time of the request, in milliseconds. */
  asked: number;
  /** Time of the first byte, in milliseconds, and the number of bytes received. */
  began: number;
  received: number;
}

interface Running extends Job {
  id: number;
  worker: Worker;
  /** True until all bytes are received. */
  open: boolean;
  /** True once the worker was asked. Before that, the page may still be preparing the request. */
  sent: boolean;
}

/** Runs one job per worker. */
export class DecoderPool {
  readonly meter = new BandwidthMeter();
  /** Decoding time of the last file. */
  milliseconds = 0;
  /** Recent decoding time per point, in milliseconds; 0 before the first file. */
  pace = 0;
  private readonly workers: Worker[] = [];
  private readonly idle: Worker[] = [];
  private readonly running = new Map<string, Running>();
  private nextId = 0;
  private onFree: () => void = () => undefined;

  /** Start one worker at once, while the manifest downloads. The second starts with the second file. early: already started. */
  constructor(
    private readonly starter: DecodeWorkers,
    private early?: EarlyWorker | null,
  ) {
    this.idle.push(this.addWorker(early?.worker));
  }

  /** Call a function whenever a worker becomes free. */
  whenFree(call: () => void): void {
    this.onFree = call;
  }

  get free(): boolean {
    return this.idle.length > 0 || this.workers.length < WORKERS;
  }

  /** Keys of the running jobs. */
  get keys(): string[] {
    return [...this.running.keys()];
  }

  has(key: string): boolean {
    return this.running.has(key);
  }

  /** Return the number of bytes received of a file. */
  received(key: string): number {
    return this.running.get(key)?.received ?? 0;
  }

  /** Return true if the rest of a file takes less than one round trip, so that the next request can be sent. */
  isNearlyHere(key: string): boolean {
    const job = this.running.get(key);
    if (!job?.open) return true;
    const answer = job.began - job.asked;
    const rate = job.received / Math.max(performance.now() - job.began, answer, 1);
    return job.received > 0 && job.source.bytes - job.received < rate * answer;
  }

  /** Start a job; requires a free worker. points: of the file, null for a page. */
  start(key: string, source: Source, points: number | null, receiver: Receiver): void {
    const { worker, early } = this.takeWorker(source.url);
    const id = early ? EARLY : this.nextId++;
    const job: Running = {
      id,
      worker,
      source,
      asked: performance.now(),
      began: 0,
      received: 0,
      open: true,
      sent: true,
    };
    this.running.set(key, job);
    this.meter.begin(performance.now());
    const finish = (report: () => void, dead = false): void => {
      this.running.delete(key);
      this.close(job);
      this.release(worker, dead);
      report();
      this.onFree();
    };
    const take = (data: DecodeReply, at?: number): void => {
      if (data.id !== job.id) return;
      if ("received" in data) {
        this.count(job, data.received, at);
        receiver.received(job);
      } else if ("trouble" in data) receiver.trouble(data.trouble);
      else if ("error" in data) finish(() => receiver.failed(data.error, data.plain));
      else if ("page" in data) finish(() => receiver.page(data.page));
      else {
        this.updatePace(data.milliseconds, points ?? 0);
        finish(() => receiver.decoded(data.file));
      }
    };
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => take(data);
    worker.onerror = (event) =>
      finish(() => receiver.failed(`${source.url} cannot be decoded (${failureOf(event)}).`, PLAIN.player), true);
    const replay = ({ data, at }: EarlyFile["replies"][number]): void => {
      if (this.running.get(key) === job) take(data, at);
      else worker.onmessage?.({ data } as MessageEvent); // canceled: this may confirm it
    };
    if (early) queueMicrotask(() => early.replies.forEach(replay));
    else if (!source.access) send(worker, { id, source, page: points === null });
    else {
      job.sent = false;
      const { access, ...plain } = source;
      requestOf(source.url, access).then(
        (request) => {
          if (this.running.get(key) !== job) return; // canceled
          job.sent = true;
          send(worker, { id, source: { ...plain, request }, page: points === null });
        },
        (error: unknown) => {
          if (this.running.get(key) === job) finish(() => receiver.failed(messageOf(error), PLAIN.refused));
        },
      );
    }
  }

  /** Return the worker for a file, with the early file if this is it. Others leave the early worker alone if there may be another. */
  private takeWorker(url: string): { worker: Worker; early: EarlyFile | null } {
    const { early, idle } = this;
    const file = early?.file ?? null; // its worker is the first of the idle ones
    const isAsked = file?.url === url;
    if (file && !isAsked && idle.length > 1) return { worker: idle.pop()!, early: null };
    if (file && !isAsked && this.workers.length < WORKERS) return { worker: this.addWorker(), early: null };
    this.early = null;
    if (file && !isAsked) send(early!.worker, { id: EARLY, cancel: true });
    return { worker: (file ? idle.shift() : idle.pop()) ?? this.addWorker(), early: isAsked ? file : null };
  }

  /** Cancel a job. */
  cancel(key: string): void {
    const job = this.running.get(key);
    if (!job) return;
    const { worker } = job;
    this.running.delete(key);
    this.close(job);
    if (!job.sent) {
      this.release(worker, false);
      return queueMicrotask(() => this.onFree());
    }
    send(worker, { id: job.id, cancel: true });
    const free = (dead: boolean): void => {
      this.release(worker, dead);
      this.onFree();
    };
    // The worker is busy until it confirms.
    worker.onmessage = ({ data }: MessageEvent<DecodeReply>) =>
      void (("file" in data || "page" in data || "error" in data) && free(false));
    worker.onerror = () => free(true);
  }

  destroy(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private addWorker(worker = this.starter.start()): Worker {
    this.workers.push(worker);
    send(worker, { files: this.starter.files() });
    return worker;
  }

  /** Return a worker to the pool. A dead one is replaced when the next job starts. */
  private release(worker: Worker, dead: boolean): void {
    if (!dead) return void this.idle.push(worker);
    worker.terminate();
    this.workers.splice(this.workers.indexOf(worker), 1);
  }

  /**
   * Count received bytes. early: time at which they arrived, if that was before the job began. Their bandwidth is not measured, and
   * the round trip is unknown: the worker was still starting when it was asked.
   */
  private count(job: Running, bytes: number, early?: number): void {
    const now = early ?? performance.now();
    if (job.received === 0) [job.began, job.asked] = [now, early ?? job.asked];
    job.received += bytes;
    if (early === undefined) this.meter.addBytes(bytes, now);
    if (job.received >= job.source.bytes) this.close(job); // only decoding is left
  }

  private close(job: Running): void {
    if (job.open) this.meter.end(performance.now());
    job.open = false;
  }

  private updatePace(milliseconds: number, points: number): void {
    this.milliseconds = milliseconds;
    if (points === 0) return;
    const pace = milliseconds / points;
    this.pace = this.pace === 0 ? pace : this.pace + 0.3 * (pace - this.pace);
  }
}

function send(worker: Worker, request: DecodeRequest): void {
  worker.postMessage(request);
}
