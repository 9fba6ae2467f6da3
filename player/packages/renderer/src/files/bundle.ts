/**
 * Addresses of the player's other files: workers, decoders, and parts loaded on demand. They lie next to this module or in the page.
 * Each name is a literal, since bundlers look for `new URL("./name", import.meta.url)`, `new Worker` of it and `import("./name")`.
 */
import { embeddedPlayerFile } from "./embedded";
import { type DecodeWorkers, openWorker, startWorker } from "@splatreel/decoder/internal";

/** Workers that download and decode files. */
export const decodeWorkers: DecodeWorkers = {
  files: () => ({
    "paper-decode.js": new URL("./paper-decode.js", import.meta.url).href,
    "draco-decode.js": new URL("./draco-decode.js", import.meta.url).href,
    "draco_decoder.wasm": new URL("./draco_decoder.wasm", import.meta.url).href,
    "hevc-worker.js": new URL("./hevc-worker.js", import.meta.url).href,
    "hevc-decode.js": new URL("./hevc-decode.js", import.meta.url).href,
    "hevc-decode.wasm": new URL("./hevc-decode.wasm", import.meta.url).href,
  }),
  start: () =>
    embeddedWorker("decode-worker.js") ??
    openWorker(
      new URL("./decode-worker.js", import.meta.url).href,
      () => new Worker(new URL("./decode-worker.js", import.meta.url), { type: "module" }),
    ),
};

/** Start a worker that sorts points. */
export function startSortWorker(): Worker {
  return (
    embeddedWorker("sort-worker.js") ??
    openWorker(
      new URL("./sort-worker.js", import.meta.url).href,
      () => new Worker(new URL("./sort-worker.js", import.meta.url), { type: "module" }),
    )
  );
}

/** Load a part of the player. load: imports the file, unless the page contains it. */
export function loadPart<T>(name: string, load: () => Promise<T>): Promise<T> {
  const inPage = embeddedPlayerFile(name);
  return inPage ? (import(URL.createObjectURL(inPage)) as Promise<T>) : load();
}

/** Return the address of the player's module for other pages; null if it is bundled into this page's script. */
export function playerAddress(): string | null {
  const { href, pathname, protocol } = new URL(import.meta.url);
  return pathname.endsWith("/player.js") && protocol.startsWith("http") ? href : null;
}

/** Start an embedded worker as a classic script, since a page opened from a disk cannot start module workers. */
function embeddedWorker(name: string): Worker | null {
  const inPage = embeddedPlayerFile(name);
  return inPage && startWorker(URL.createObjectURL(inPage));
}
