/** Worker that downloads and decodes the files of a reel, one message per file. It loads the paper's codec only for files of it. */
import code from "../../wasm/kernels.wasm";
import { ReelError, messageOf } from "../base/errors";
import { download } from "../files/download";
import type { Source } from "../files/source";
import { fileAddress, type FileAddresses } from "../files/workers";
import { parseJson } from "../reel/json";
import { utf8 } from "../base/text";
import { buffersOf, decodeFile, type DecodedFile, type DecodePaper } from "./decode-file";
import { plain, type Kernels } from "./kernels";
import { wasmKernels } from "./wasm";

/** Request to the worker: the addresses of the player's files, once; download and decode a file, read a page, or cancel one of these. */
export type DecodeRequest =
  { files: FileAddresses } | { id: number; source: Source; page: boolean } | { id: number; cancel: true };

/** Reply of the worker: bytes received, the reason for a retry, and finally a decoded file, the unchecked JSON of a page, or an error. */
export type DecodeReply = { id: number } & (
  | { received: number }
  | { trouble: string }
  | { file: DecodedFile; milliseconds: number }
  | { page: unknown }
  | { error: string; plain?: string | undefined }
);

const scope = self as unknown as {
  onmessage: (event: MessageEvent<DecodeRequest>) => void;
  postMessage(message: DecodeReply, transfer?: Transferable[]): void;
};
let tellFiles: (files: FileAddresses) => void;
/** Addresses of the player's files. They may arrive after the first request. */
const files = new Promise<FileAddresses>((resolve) => (tellFiles = resolve));
const running = new Map<number, AbortController>();
const kernels = loadKernels();

scope.onmessage = async ({ data }) => {
  if ("files" in data) return tellFiles(data.files);
  const { id } = data;
  if ("cancel" in data) return running.get(id)?.abort();
  const controller = new AbortController();
  running.set(id, controller);
  try {
    const watcher = {
      received: (bytes: number) => scope.postMessage({ id, received: bytes }),
      trouble: (why: string) => scope.postMessage({ id, trouble: why }),
    };
    const { source, page } = data;
    const bytes = await download(source, watcher, controller.signal);
    const began = performance.now();
    if (page) return scope.postMessage({ id, page: parsePage(bytes, source.url) });
    const file = await decodeFile(bytes, source.url, decodePaper, await kernels);
    scope.postMessage({ id, file, milliseconds: performance.now() - began }, buffersOf(file));
  } catch (error) {
    scope.postMessage({ id, error: messageOf(error), plain: error instanceof ReelError ? error.plain : undefined });
  } finally {
    running.delete(id);
  }
};

/** Decode a file of the paper's codec. */
const decodePaper: DecodePaper = async (file, kernels) => {
  const addresses = await files;
  const part = (await import(fileAddress(addresses, "paper-decode.js"))) as typeof import("./paper-decode");
  return part.decodePaperFile(file, addresses, kernels);
};

function parsePage(bytes: Uint8Array, name: string): unknown {
  try {
    return parseJson(utf8(bytes));
  } catch {
    throw new ReelError(`${name} is damaged: it is not JSON.`);
  }
}

/** Return the WebAssembly kernels, or the plain ones if the browser lacks SIMD or the page's policy forbids WebAssembly. */
async function loadKernels(): Promise<Kernels> {
  try {
    return wasmKernels(await WebAssembly.compile(code));
  } catch {
    return plain;
  }
}
