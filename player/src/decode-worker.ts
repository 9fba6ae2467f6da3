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

async function download(url: string, bytes: number): Promise<Uint8Array> {
  let data: Uint8Array;
  try {
    const response = await fetch(url);
    if (!response.ok) throw new ReelError(`it answered ${response.status} ${response.statusText}`.trim());
    data = new Uint8Array(await response.arrayBuffer());
  } catch (error) {
    throw new ReelError(`${url} cannot be downloaded: ${messageOf(error)}.`);
  }
  if (data.byteLength !== bytes) throw new ReelError(`${url} has ${data.byteLength} bytes, the manifest says ${bytes}. It may still be uploading: try again.`);
  return data;
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
