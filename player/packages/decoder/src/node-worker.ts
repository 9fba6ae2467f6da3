/** First script of a thread: gives a worker's script the globals of a web worker, and runs it. */
import { createRequire } from "node:module";
import { parentPort, workerData } from "node:worker_threads";
import { ThreadWorker } from "./thread-worker";

const scope = globalThis as unknown as { onmessage(event: { data: unknown }): void };
const port = parentPort!;
const web = {
  self: scope,
  Worker: ThreadWorker,
  postMessage: (message: unknown, transfer?: unknown[]) => port.postMessage(message, transfer),
};
// The third-party decoders expect the globals of CommonJS.
Object.assign(scope, web, { require: createRequire(import.meta.url), __dirname: "", __filename: "" });
await import(workerData as string);
port.on("message", (data) => scope.onmessage({ data }));
