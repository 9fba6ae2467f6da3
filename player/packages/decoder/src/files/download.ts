/** Downloads over unreliable networks: retries with growing pauses, resumes interrupted transfers, and verifies checksums. */
import { PLAIN, ReelError, messageOf } from "../base/errors";
import { utf8 } from "../base/text";
import { isIntact } from "./checksum";
import { LONGEST_MANIFEST, readLocalFile } from "./local-files";
import { requestOf, type Access, type FileRequest, type Source, type Watcher } from "./source";

/** Pauses before retries, in milliseconds, plus up to half as much at random. After the last one the download fails. */
const PAUSES = [300, 1000, 2000, 4000, 6000];
/** Milliseconds without a byte after which a transfer has stalled. */
const STALL = 8000;

/** A temporary failure, and the number of retries for it. */
class TransientError extends Error {
  constructor(
    why: string,
    readonly tries = PAUSES.length,
    readonly status = 0,
    readonly plain = PLAIN.network,
  ) {
    super(why);
  }
}

/** Number of retries for a file that differs from the manifest, and for the manifest itself, for which people wait. */
const FEW_RETRIES = 2;

/** Download a whole file. Throws `ReelError` with the URL, or the `AbortError` of the signal. */
export async function download(source: Source, watcher: Watcher, signal: AbortSignal): Promise<Uint8Array> {
  if (source.part) return readLocalFile(source, source.part, watcher);
  const transfer = { body: new Uint8Array(source.bytes), filled: 0 };
  return withRetries(source.url, watcher, signal, async (again) => {
    await receive(source, transfer, again, watcher, signal);
    await check(source, transfer);
    return transfer.body;
  });
}

/** Download the text of the manifest, revalidated with the host. */
export function downloadText(url: string, watcher: Watcher, signal: AbortSignal, access?: Access): Promise<string> {
  return withRetries(url, watcher, signal, () =>
    withStallTimeout(signal, FEW_RETRIES, async (inner, alive) => {
      const how = access && (await requestOf(url, access));
      const answer = await request(url, how, { cache: "no-cache", signal: inner }, FEW_RETRIES);
      const parts: Uint8Array[] = [];
      let left = LONGEST_MANIFEST;
      try {
        await readAll(answer, FEW_RETRIES, (value) => {
          alive();
          left -= value.byteLength;
          if (left < 0) throw new ReelError(`it is longer than ${LONGEST_MANIFEST} bytes`);
          parts.push(value);
        });
        return utf8(await new Blob(parts as BlobPart[]).arrayBuffer());
      } catch (error) {
        throw error instanceof ReelError
          ? new ReelError(`${url} is not a reel's manifest: ${error.message}.`, { plain: PLAIN.other })
          : error;
      }
    }),
  );
}

/** Repeat `attempt` until it succeeds, fails permanently, or has used all retries. */
async function withRetries<T>(
  url: string,
  watcher: Watcher,
  signal: AbortSignal,
  attempt: (again: boolean) => Promise<T>,
): Promise<T> {
  for (let failures = 0; ;) {
    try {
      return await attempt(failures > 0);
    } catch (error) {
      if (signal.aborted || !(error instanceof TransientError)) throw error;
      const offline = globalThis.navigator?.onLine === false;
      if (!offline && failures >= error.tries)
        throw new ReelError(`${url} cannot be downloaded: ${error.message}.`, { plain: error.plain });
      watcher.trouble(offline ? "Offline. Waiting for the network." : `Retrying: ${error.message}.`);
      await pause(PAUSES[failures] * (1 + Math.random() / 2), signal);
      // While offline, retries are unlimited.
      if (!offline || failures < PAUSES.length - 1) failures++;
    }
  }
}

/** Send a request. Throws unless the response is successful. */
async function request(
  url: string,
  how: FileRequest | undefined,
  options: RequestInit,
  tries = PAUSES.length,
): Promise<Response> {
  const { url: address = url, credentials = "same-origin", headers } = how ?? {};
  let response: Response;
  try {
    response = await fetch(address, { ...options, credentials, headers: { ...headers, ...options.headers } });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    if (await answersOthers(address)) {
      throw new ReelError(
        `${url} exists, but its host does not let ${readers()} read it. It must send ${corsOf(credentials, headers)}.`,
        { plain: PLAIN.refused },
      );
    }
    throw new TransientError(`${messageOf(error)}. Check the address and the network`, tries);
  }
  if (response.ok) return response;
  const why = `it answered ${response.status} ${response.statusText}`.trim();
  if (response.status >= 500 || [408, 416, 425, 429].includes(response.status))
    throw new TransientError(why, tries, response.status);
  throw new ReelError(`${url} cannot be downloaded: ${why}.`, {
    plain: [401, 403].includes(response.status) ? PLAIN.refused : PLAIN.missing,
  });
}

/** Run `work` with a timeout that `alive` restarts. */
async function withStallTimeout<T>(
  signal: AbortSignal,
  tries: number,
  work: (inner: AbortSignal, alive: () => void) => Promise<T>,
): Promise<T> {
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
    if (controller.signal.aborted && !signal.aborted)
      throw new TransientError("no data arrived for some seconds", tries);
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
    const { done, value } = await reader
      .read()
      .catch((error: unknown) => Promise.reject(new TransientError(messageOf(error), tries)));
    if (done) return;
    take(value);
  }
}

async function receive(
  source: Source,
  transfer: { body: Uint8Array; filled: number },
  again: boolean,
  watcher: Watcher,
  signal: AbortSignal,
): Promise<void> {
  await withStallTimeout(signal, PAUSES.length, async (inner, alive) => {
    const headers: HeadersInit = transfer.filled > 0 ? { Range: `bytes=${transfer.filled}-` } : {};
    const how = source.access ? await requestOf(source.url, source.access) : source.request;
    const options: RequestInit = { headers, cache: again ? "reload" : "default", signal: inner };
    const response = await request(source.url, how, options).catch((error: unknown) => {
      if (error instanceof TransientError && error.status === 416) transfer.filled = 0;
      throw error;
    });
    if (response.status !== 206) transfer.filled = 0; // the host ignored the range
    await readAll(response, PAUSES.length, (value) => {
      alive();
      if (transfer.filled + value.byteLength > source.bytes) {
        transfer.filled = 0;
        throw new TransientError(
          `it has more than the ${source.bytes} bytes of the manifest`,
          FEW_RETRIES,
          0,
          PLAIN.damaged,
        );
      }
      transfer.body.set(value, transfer.filled);
      transfer.filled += value.byteLength;
      watcher.received(value.byteLength);
    });
  });
  if (transfer.filled < source.bytes)
    throw new TransientError(`it ended after ${transfer.filled} of ${source.bytes} bytes`);
}

async function check({ sha256 }: Source, transfer: { body: Uint8Array; filled: number }): Promise<void> {
  if (await isIntact(transfer.body, sha256)) return;
  transfer.filled = 0;
  throw new TransientError("its checksum differs from the manifest", FEW_RETRIES, 0, PLAIN.damaged);
}

/** Return true if a host of another origin responds at all, which means that CORS blocked the request. Only browsers block requests. */
function answersOthers(url: string): Promise<boolean> {
  if (!globalThis.location || new URL(url, location.href).origin === self.origin) return Promise.resolve(false);
  return fetch(url, { mode: "no-cors", signal: AbortSignal.timeout(STALL) }).then(
    () => true,
    () => false,
  );
}

/** Name the headers by which a host admits a request of another origin. */
function corsOf(credentials: RequestCredentials, headers: FileRequest["headers"]): string {
  const names = Object.keys(headers ?? {}).join(", ");
  return [
    "the header Access-Control-Allow-Origin",
    ...(credentials === "include" ? ["with this origin, and Access-Control-Allow-Credentials: true"] : []),
    ...(names ? [`and Access-Control-Allow-Headers: ${names}`] : []),
  ].join(" ");
}

/** Name the pages that a host must admit. A sandboxed frame has no origin; `location.origin` would name that of its address. */
function readers(): string {
  return self.origin === "null" ? "sandboxed frames" : `pages of ${self.origin}`;
}

/** Wait, or until the network is back. */
function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const finish = (): void => {
      clearTimeout(timer);
      globalThis.removeEventListener?.("online", finish);
      signal.removeEventListener("abort", finish);
      if (signal.aborted) reject(signal.reason);
      else resolve();
    };
    const timer = setTimeout(finish, milliseconds);
    globalThis.addEventListener?.("online", finish);
    signal.addEventListener("abort", finish);
  });
}
