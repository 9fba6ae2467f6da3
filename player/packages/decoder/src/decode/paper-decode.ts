/** Part of the decode worker for files of the paper's codec, loaded on demand. Each video track is decoded in a worker of its own. */
import { ReelError } from "../base/errors";
import { failureOf, fileAddress, openWorker, type FileAddresses } from "../files/workers";
import type { Container } from "../reel/container";
import type { PointsAndOffsets } from "./decode-file";
import { decodeDraco } from "./draco";
import type { Kernels } from "./kernels";
import type { Track } from "./mp4";
import { decodePaper } from "./paper";

const idle: Worker[] = [];

/** Decode a file. files: addresses of the player's files. */
export function decodePaperFile(file: Container, files: FileAddresses, kernels: Kernels): Promise<PointsAndOffsets> {
  return decodePaper(
    file,
    (cloud) => decodeDraco(cloud, files),
    (track) => decodeInWorker(track, files),
    kernels,
  );
}

function openHevcWorker(files: FileAddresses): Worker {
  const worker = openWorker(fileAddress(files, "hevc-worker.js"));
  worker.postMessage({ files });
  return worker;
}

function decodeInWorker(track: Track, files: FileAddresses): Promise<Uint8Array> {
  const worker = idle.pop() ?? openHevcWorker(files);
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }: MessageEvent<{ planes?: Uint8Array; error?: string }>) => {
      idle.push(worker);
      if (data.planes) resolve(data.planes);
      else reject(new ReelError(data.error ?? "the video decoder failed"));
    };
    worker.onerror = (event) => {
      worker.terminate();
      reject(new ReelError(`the video decoder failed (${failureOf(event)})`));
    };
    worker.postMessage(track, [
      track.hvcC.buffer as ArrayBuffer,
      ...track.samples.map((sample) => sample.buffer as ArrayBuffer),
    ]);
  });
}
