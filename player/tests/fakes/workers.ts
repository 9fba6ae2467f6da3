/** Workers that a test speaks for. */
import "./page";

export class FakeWorker extends EventTarget {
  /** All that were started, the first first. */
  static readonly all: FakeWorker[] = [];

  onmessage: ((event: MessageEvent) => void) | null = null;
  onerror: ((event: ErrorEvent) => void) | null = null;
  terminated = false;
  /** What it was sent. */
  // eslint-disable-next-line @typescript-eslint/no-explicit-any
  readonly posted: any[] = [];

  constructor() {
    super();
    FakeWorker.all.push(this);
  }

  postMessage(message: unknown): void {
    this.posted.push(message);
  }

  terminate(): void {
    this.terminated = true;
  }

  say(data: unknown): void {
    this.onmessage?.({ data } as MessageEvent);
  }

  die(message = ""): void {
    this.onerror?.({ message } as ErrorEvent);
  }
}

globalThis.Worker = FakeWorker as unknown as typeof Worker;

/** What a decode worker answers in the end. */
export const FILE = { points: { count: 0 }, alive: new Uint8Array(), offsets: null, light: null };
