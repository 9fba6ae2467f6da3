/** Workers that a test speaks for. */
import assert from "node:assert/strict";
import "./page";

export class FakeWorker extends EventTarget {
  /** All that were started, the first first. */
  static readonly all: FakeWorker[] = [];
  /** Called with what any of them is sent. */
  static posted: ((worker: FakeWorker, message: unknown) => void) | null = null;

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
    FakeWorker.posted?.(this, message);
  }

  terminate(): void {
    this.terminated = true;
  }

  say(data: unknown): void {
    if (!this.terminated) this.onmessage?.({ data } as MessageEvent);
  }

  die(message = ""): void {
    this.onerror?.({ message } as ErrorEvent);
  }
}

globalThis.Worker = FakeWorker as unknown as typeof Worker;

/** What a decode worker answers in the end. */
export const FILE = {
  kind: "group",
  index: 0,
  firstFrame: 0,
  frames: 10,
  points: { count: 0, shDegree: 0 },
  alive: new Uint8Array(),
  offsets: null,
  light: null,
};

/** What all decode workers are asked for, and what becomes of it. Files by their paths within the reel: groups/1.bin. */
export class Transfers {
  /** fileAt: what is in a file. */
  constructor(private readonly fileAt: (uri: string) => object) {}

  /** Asked for and not over, in the order in which it was asked for. */
  get coming(): string[] {
    return this.requests
      .filter(({ given }) => !given)
      .sort((a, b) => a.id - b.id)
      .map(({ uri }) => uri);
  }

  /** What was given up since the last time that this was asked. */
  get givenUp(): string[] {
    const found = this.requests.filter(
      ({ given, worker }) => given && !worker.posted.some(({ told }) => told === given.id),
    );
    for (const { given, worker } of found) worker.posted.push({ told: given!.id });
    return found.map(({ uri }) => uri);
  }

  say(uri: string, what: object): void {
    const { worker, id } =
      this.requests.findLast((request) => request.uri === uri && !request.given) ??
      assert.fail(`nobody gets ${uri}, but ${this.coming}`);
    if ("file" in what || "page" in what || "error" in what)
      worker.posted.splice(
        worker.posted.findIndex((request) => request.id === id),
        1,
      );
    worker.say({ id, ...what });
  }

  bytes(uri: string, received: number): void {
    this.say(uri, { received });
  }

  /** Files come, whole. */
  give(...uris: string[]): void {
    for (const uri of uris)
      this.say(uri, uri.startsWith("pages") ? { page: this.fileAt(uri) } : { file: this.fileAt(uri), milliseconds: 0 });
  }

  /** All files come that are asked for. */
  giveAll(): void {
    while (this.coming.length > 0) this.give(this.coming[0]);
  }

  /** The workers have seen that files are given up. */
  confirm(): void {
    for (const { worker, id, given } of this.requests) if (given) worker.say({ id, error: "given up" });
  }

  private get requests(): { uri: string; id: number; worker: FakeWorker; given: { id: number } | null }[] {
    return FakeWorker.all
      .filter(({ terminated }) => !terminated)
      .flatMap((worker) =>
        worker.posted.flatMap(({ id, source }) => {
          const given = worker.posted.find((request) => request.cancel && request.id === id) ?? null;
          return source ? [{ uri: new URL(source.url).pathname.replace("/reel/", ""), id, worker, given }] : [];
        }),
      );
  }
}
