/** An audio element and a media source that do as a test says. */
import "./page";

/** Sound runs on its own: a test sets `currentTime`. */
export class FakeAudio extends EventTarget {
  static last: FakeAudio;
  currentTime = 0;
  paused = true;
  ended = false;
  volume = 1;
  playbackRate = 1;
  preservesPitch = false;
  disableRemotePlayback = false;
  src = "";
  /** What play() rejects with: the name of an error; "": it plays. */
  refuses = "";
  /** What it can play of files. */
  static plays = "";

  constructor() {
    super();
    FakeAudio.last = this;
  }

  play(): Promise<void> {
    if (this.refuses) return Promise.reject(Object.assign(new Error("no"), { name: this.refuses }));
    this.paused = false;
    return Promise.resolve();
  }

  pause(): void {
    this.paused = true;
  }

  canPlayType(): string {
    return FakeAudio.plays;
  }

  removeAttribute(): void {
    this.src = "";
  }

  load(): void {
    this.paused = true;
  }
}

/** Takes segments whose bytes are their start and their length in seconds. */
class FakeBuffer {
  onupdateend: (() => void) | null = null;
  onerror: (() => void) | null = null;
  ranges: [number, number][] = [];

  get buffered(): { length: number; start(i: number): number; end(i: number): number } {
    return { length: this.ranges.length, start: (i) => this.ranges[i][0], end: (i) => this.ranges[i][1] };
  }

  appendBuffer(bytes: Uint8Array): void {
    if (bytes.length === 2) this.ranges.push([bytes[0], bytes[0] + bytes[1]]);
    queueMicrotask(() => (bytes.length === 3 ? this.onerror?.() : this.onupdateend?.()));
  }

  remove(start: number, end: number): void {
    this.ranges = this.ranges.filter(([from, to]) => to <= start || from >= end);
    queueMicrotask(() => this.onupdateend?.());
  }
}

export class FakeMediaSource extends EventTarget {
  static last: FakeMediaSource;
  readyState = "closed";
  readonly buffer = new FakeBuffer();
  static isTypeSupported = (): boolean => true;

  constructor() {
    super();
    FakeMediaSource.last = this;
  }

  addSourceBuffer(): FakeBuffer {
    if (this.readyState !== "open") throw new Error("it is not open");
    return this.buffer;
  }

  open(): void {
    this.readyState = "open";
    this.dispatchEvent(new Event("sourceopen"));
  }

  endOfStream(): void {
    this.readyState = "ended";
  }
}

Object.assign(globalThis, { Audio: FakeAudio });
URL.createObjectURL = () => "blob:sound";
URL.revokeObjectURL = () => undefined;
