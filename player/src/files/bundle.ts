/**
 * Workers, decoders and parts that are loaded when they are asked for lie next to this module, or in the page itself. Each is named
 * by a literal, since bundlers look for `new URL("./name", import.meta.url)`, `new Worker` of that and `import("./name")`.
 */
import { embeddedPlayerFile } from "./embedded";
import { openWorker, type FileAddresses } from "./workers";

/** What decode workers load when a reel needs it. */
export function decoderFiles(): FileAddresses {
  return {
    "draco-decode.js": new URL("./draco-decode.js", import.meta.url).href,
    "draco_decoder.wasm": new URL("./draco_decoder.wasm", import.meta.url).href,
    "hevc-worker.js": new URL("./hevc-worker.js", import.meta.url).href,
    "hevc-decode.js": new URL("./hevc-decode.js", import.meta.url).href,
    "hevc-decode.wasm": new URL("./hevc-decode.wasm", import.meta.url).href,
  };
}

/** Start a worker that gets and decodes files. It has to be sent `decoderFiles` first. */
export function startDecodeWorker(): Worker {
  return (
    embeddedWorker("decode-worker.js") ??
    openWorker(new URL("./decode-worker.js", import.meta.url).href, () => new Worker(new URL("./decode-worker.js", import.meta.url), { type: "module" }))
  );
}

export function startSortWorker(): Worker {
  return (
    embeddedWorker("sort-worker.js") ??
    openWorker(new URL("./sort-worker.js", import.meta.url).href, () => new Worker(new URL("./sort-worker.js", import.meta.url), { type: "module" }))
  );
}

/** Load a part of the player when it is first needed. load: imports it, where the page does not hold it. */
export function loadPart<T>(name: string, load: () => Promise<T>): Promise<T> {
  const inPage = embeddedPlayerFile(name);
  return inPage ? (import(URL.createObjectURL(inPage)) as Promise<T>) : load();
}

/** The address of the player's module, for pages of others; null where it is a part of this page's own script. */
export function playerAddress(): string | null {
  const { href, pathname, protocol } = new URL(import.meta.url);
  return pathname.endsWith("/player.js") && protocol.startsWith("http") ? href : null;
}

/** Workers import nothing before they are told to, so each can be a plain script: a page on a disk cannot start modules. */
function embeddedWorker(name: string): Worker | null {
  const inPage = embeddedPlayerFile(name);
  return inPage && new Worker(URL.createObjectURL(inPage));
}
