/** Fetches and decodes the files of a reel, one message a file; each video track gets a worker of its own. */
import { buffersOf, decodeFile } from "./decode";
import { decodeDraco } from "./draco";
import { ReelError, messageOf } from "./errors";
import type { Track } from "./mp4";

export interface DecodeRequest {
  id: number;
  url: string;
  /** What the manifest says the file has. */
  bytes: number;
}

const scope = self as unknown as { onmessage: (event: MessageEvent<DecodeRequest>) => void; postMessage(message: object, transfer?: Transferable[]): void };

scope.onmessage = async ({ data: { id, url, bytes } }) => {
  try {
    const file = await decodeFile(await download(url, bytes), url, decodeDraco, decodeInWorker);
    scope.postMessage({ id, file }, buffersOf(file));
  } catch (error) {
    scope.postMessage({ id, error: messageOf(error) });
  }
};

/** Waits before trying again, milliseconds: a busy host or a lost network is often back by then. */
const PAUSES = [300, 1200];

async function download(url: string, bytes: number): Promise<Uint8Array> {
  for (let attempt = 0; ; attempt++) {
    const result = await tryDownload(url, bytes, attempt === 0 ? "default" : "reload");
    if (result instanceof Uint8Array) return result;
    if (!result.passing || attempt === PAUSES.length) throw new ReelError(`${url} cannot be downloaded: ${result.why}.`);
    await new Promise((resolve) => setTimeout(resolve, PAUSES[attempt]));
  }
}

/** The file, or why not and whether that may pass. */
async function tryDownload(url: string, bytes: number, cache: RequestCache): Promise<Uint8Array | { why: string; passing: boolean }> {
  try {
    const response = await fetch(url, { cache });
    if (!response.ok) {
      const passing = response.status >= 500 || response.status === 429;
      return { why: `it answered ${response.status} ${response.statusText}`.trim(), passing };
    }
    const data = new Uint8Array(await response.arrayBuffer());
    if (data.byteLength === bytes) return data;
    return { why: `it has ${data.byteLength} bytes, the manifest says ${bytes}`, passing: true };
  } catch (error) {
    return { why: messageOf(error), passing: true };
  }
}

const idle: Worker[] = [];

function decodeInWorker(track: Track): Promise<Uint8Array> {
  const worker = idle.pop() ?? new Worker(new URL("hevc-worker.js", self.location.href));
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }: MessageEvent<{ planes?: Uint8Array; error?: string }>) => {
      idle.push(worker);
      if (data.planes) resolve(data.planes);
      else reject(new ReelError(data.error ?? "the video decoder failed"));
    };
    worker.onerror = (event) => {
      worker.terminate();
      reject(new ReelError(`the video decoder failed (${event.message})`));
    };
    worker.postMessage(track, [track.hvcC.buffer as ArrayBuffer, ...track.samples.map((sample) => sample.buffer as ArrayBuffer)]);
  });
}
