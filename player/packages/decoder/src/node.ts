/** Entry point for Node and Deno: files are decoded in threads, and reels may be folders. */
import { readFileSync, statSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { openSource, type ReelFiles } from "./reader/open-source";
import type { ReelOptions, ReelReader } from "./reader/reel-reader";
import type { DecodeWorkers } from "./stream/decoder-pool";
import { ThreadWorker } from "./thread-worker";

export { ReelError } from "./base/errors";
export type * from "./reader/types";

const FILES = [
  "paper-decode.js",
  "draco-decode.js",
  "draco_decoder.wasm",
  "hevc-worker.js",
  "hevc-decode.js",
  "hevc-decode.wasm",
];
const beside = (name: string): string => new URL(name, import.meta.url).href;
const workers: DecodeWorkers = {
  files: () => Object.fromEntries(FILES.map((name) => [name, beside(name)])),
  start: () => new ThreadWorker(beside("decode-worker.js")) as unknown as Worker,
};

/** Open a reel by its folder, by the path or address of its manifest.json, or by a function that returns its files. Throws `ReelError`. */
export function openReel(source: string | URL | ReelFiles, options?: ReelOptions): Promise<ReelReader> {
  if (typeof source === "function" || /^(https?|data|blob):/.test(String(source)))
    return openSource(source, workers, options);
  const path = String(source).startsWith("file:") ? fileURLToPath(source) : String(source);
  return openSource(filesAt(path), workers, options, path);
}

/** Return the files of a folder, or of the folder of a manifest.json. */
function filesAt(path: string): ReelFiles {
  const folder = statSync(path, { throwIfNoEntry: false })?.isFile() ? dirname(path) : path;
  return (uri) => {
    const file = join(folder, uri);
    return statSync(file, { throwIfNoEntry: false })?.isFile() ? new Blob([readFileSync(file)]) : null;
  };
}
