/** Entry point for browsers: files are decoded in web workers. */
import { openWorker } from "./files/workers";
import { openSource, type ReelFiles } from "./reader/open-source";
import type { ReelOptions, ReelReader } from "./reader/reel-reader";
import type { DecodeWorkers } from "./stream/decoder-pool";

export { ReelError } from "./base/errors";
export type * from "./reader/types";

const workers: DecodeWorkers = {
  files: () => ({
    "paper-decode.js": new URL("./paper-decode.js", import.meta.url).href,
    "draco-decode.js": new URL("./draco-decode.js", import.meta.url).href,
    "draco_decoder.wasm": new URL("./draco_decoder.wasm", import.meta.url).href,
    "hevc-worker.js": new URL("./hevc-worker.js", import.meta.url).href,
    "hevc-decode.js": new URL("./hevc-decode.js", import.meta.url).href,
    "hevc-decode.wasm": new URL("./hevc-decode.wasm", import.meta.url).href,
  }),
  start: () =>
    openWorker(
      new URL("./decode-worker.js", import.meta.url).href,
      () => new Worker(new URL("./decode-worker.js", import.meta.url), { type: "module" }),
    ),
};

/** Open a reel by the address of its manifest.json, or by a function that returns its files. Throws `ReelError`. */
export function openReel(source: string | URL | ReelFiles, options?: ReelOptions): Promise<ReelReader> {
  return openSource(source, workers, options);
}
