/** A web worker for Node, made of a thread. */
import { Worker as Thread } from "node:worker_threads";

/** The part of `Worker` that decoding uses. */
export class ThreadWorker {
  onmessage: ((event: { data: unknown }) => void) | null = null;
  onerror: ((event: { message: string }) => void) | null = null;
  private readonly thread: Thread;

  /** Start a thread that runs a script. */
  constructor(address: string) {
    this.thread = new Thread(new URL("./node-worker.js", import.meta.url), { workerData: address });
    this.thread.on("message", (data) => this.onmessage?.({ data }));
    this.thread.on("error", (error) => this.onerror?.({ message: (error as Error).message }));
  }

  postMessage(message: unknown, transfer: unknown[] = []): void {
    this.thread.postMessage(message, transfer);
  }

  terminate(): void {
    void this.thread.terminate();
  }
}
