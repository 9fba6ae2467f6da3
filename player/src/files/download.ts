/** Gets a file over networks that fail: tries again after growing pauses, goes on where a transfer broke off, checks what came. */
import { PLAIN, ReelError, messageOf } from "../base/errors";
import { isIntact } from "./checksum";
import { readLocalFile } from "./local-files";
import type { Source, Watcher } from "./source";

/** Waits before trying again, milliseconds; after the last one a file is given up. Up to half as much is added by chance. */
const PAUSES = [300, 1000, 2000, 4000, 6000];
/** A transfer without a byte for this long has stalled. */
const STALL = 8000;

/** A failure that may pass, and how often it is worth trying again. */
class TransientError extends Error {
  constructor(why: string, readonly tries = PAUSES.length, readonly status = 0, readonly plain = PLAIN.network) {
    super(why);
  }
}

/** Of a file that came but is not what the manifest says, and of a manifest that a person waits for. */
const FEW = 2;

/** The whole file. Throws `ReelError` with the url, or the signal's `AbortError`. */
export async function download(source: Source, watcher: Watcher, signal: AbortSignal): Promise<Uint8Array> {
  if (source.part) return readLocalFile(source, source.part, watcher);
  const transfer = { body: new Uint8Array(source.bytes), filled: 0 };
  return withRetries(source.url, watcher, signal, async (again) => {
    await receive(source, transfer, again, watcher, signal);
    await check(source, transfer);
    return transfer.body;
  });
}

/** Text of a small file, for the manifest. Always asks the host whether it is still the same. */
export function downloadText(url: string, watcher: Watcher, signal: AbortSignal): Promise<string> {
  return withRetries(url, watcher, signal, () =>
    withStallTimeout(signal, FEW, async (inner, alive) => {
      const answer = await request(url, { cache: "no-cache", signal: inner }, FEW);
      const decoder = new TextDecoder();
      let text = "";
      await readAll(answer, FEW, (value) => {
        alive();
        text += decoder.decode(value, { stream: true });
      });
      return text + decoder.decode();
    }),
  );
}

/** Try until it works, is given up, or fails in a way that will not pass. */
async function withRetries<T>(url: string, watcher: Watcher, signal: AbortSignal, attempt: (again: boolean) => Promise<T>): Promise<T> {
  for (let failures = 0; ; ) {
    try {
      return await attempt(failures > 0);
    } catch (error) {
      if (signal.aborted || !(error instanceof TransientError)) throw error;
      const offline = navigator.onLine === false;
      if (!offline && failures >= error.tries) throw new ReelError(`${url} cannot be downloaded: ${error.message}.`, { plain: error.plain });
      watcher.trouble(offline ? "Offline. Waiting for the network." : `Trying again: ${error.message}.`);
      await pause(PAUSES[failures] * (1 + Math.random() / 2), signal);
      // Without a network nothing is given up.
      if (!offline || failures < PAUSES.length - 1) failures++;
    }
  }
}

/** One answer, of which only a good one comes back. */
async function request(url: string, options: RequestInit, tries = PAUSES.length): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(url, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    if (await answersOthers(url)) {
      throw new ReelError(`${url} is there, but its host does not let pages of ${location.origin} read it. It must send the header Access-Control-Allow-Origin.`, { plain: PLAIN.refused });
    }
    throw new TransientError(`${messageOf(error)}. Check the address and the network`, tries);
  }
  if (response.ok) return response;
  const why = `it answered ${response.status} ${response.statusText}`.trim();
  if (response.status >= 500 || [408, 416, 425, 429].includes(response.status)) throw new TransientError(why, tries, response.status);
  throw new ReelError(`${url} cannot be downloaded: ${why}.`, { plain: [401, 403].includes(response.status) ? PLAIN.refused : PLAIN.missing });
}

/** Work that is given up when nothing comes for a while: `alive` says that something came. */
async function withStallTimeout<T>(signal: AbortSignal, tries: number, work: (inner: AbortSignal, alive: () => void) => Promise<T>): Promise<T> {
  signal.throwIfAborted();
  const controller = new AbortController();
  const abort = (): void => controller.abort();
  signal.addEventListener("abort", abort);
  let alarm = setTimeout(abort, STALL);
  const alive = (): void => {
    clearTimeout(alarm);
    alarm = setTimeout(abort, STALL);
  };
  try {
    return await work(controller.signal, alive);
  } catch (error) {
    if (controller.signal.aborted && !signal.aborted) throw new TransientError("nothing came for some seconds", tries);
    throw error;
  } finally {
    clearTimeout(alarm);
    signal.removeEventListener("abort", abort);
    controller.abort();
  }
}

async function readAll(response: Response, tries: number, take: (value: Uint8Array) => void): Promise<void> {
  const reader = response.body!.getReader();
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => Promise.reject(new TransientError(messageOf(error), tries)));
    if (done) return;
    take(value);
  }
}

async function receive(source: Source, transfer: { body: Uint8Array; filled: number }, again: boolean, watcher: Watcher, signal: AbortSignal): Promise<void> {
  await withStallTimeout(signal, PAUSES.length, async (inner, alive) => {
    const headers: HeadersInit = transfer.filled > 0 ? { Range: `bytes=${transfer.filled}-` } : {};
    const response = await request(source.url, { headers, cache: again ? "reload" : "default", signal: inner }).catch((error: unknown) => {
      if (error instanceof TransientError && error.status === 416) transfer.filled = 0;
      throw error;
    });
    if (response.status !== 206) transfer.filled = 0; // the host begins anew
    await readAll(response, PAUSES.length, (value) => {
      alive();
      if (transfer.filled + value.byteLength > source.bytes) {
        transfer.filled = 0;
        throw new TransientError(`it has more than the ${source.bytes} bytes of the manifest`, FEW, 0, PLAIN.damaged);
      }
      transfer.body.set(value, transfer.filled);
      transfer.filled += value.byteLength;
      watcher.received(value.byteLength);
    });
  });
  if (transfer.filled < source.bytes) throw new TransientError(`it ended after ${transfer.filled} of ${source.bytes} bytes`);
}

async function check({ sha256 }: Source, transfer: { body: Uint8Array; filled: number }): Promise<void> {
  if (await isIntact(transfer.body, sha256)) return;
  transfer.filled = 0;
  throw new TransientError("its checksum is not the manifest's", FEW, 0, PLAIN.damaged);
}

/** Whether a host that this page may not read from answers at all. */
function answersOthers(url: string): Promise<boolean> {
  if (new URL(url, location.href).origin === location.origin) return Promise.resolve(false);
  return fetch(url, { mode: "no-cors", signal: AbortSignal.timeout(STALL) }).then(() => true, () => false);
}

/** Wait, but no longer than until the network is back. */
function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const finish = (): void => {
      clearTimeout(timer);
      removeEventListener("online", finish);
      signal.removeEventListener("abort", finish);
      if (signal.aborted) reject(signal.reason);
      else resolve();
    };
    const timer = setTimeout(finish, milliseconds);
    addEventListener("online", finish);
    signal.addEventListener("abort", finish);
  });
}
