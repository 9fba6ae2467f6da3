/** Verdicts of the decoder on whole reels. Files are decoded in this thread, so that thousands of reels take little time. */
import { readdirSync, readFileSync, statSync } from "node:fs";
import { join } from "node:path";
import { ReelError, messageOf } from "../packages/decoder/src/base/errors";
import { decodePaper } from "../packages/decoder/src/decode/paper";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import type { DecodeReply, DecodeRequest } from "../packages/decoder/src/decode/decode-worker";
import { download } from "../packages/decoder/src/files/download";
import { LocalFiles } from "../packages/decoder/src/files/local-files";
import { ReelReader } from "../packages/decoder/src/reader/reel-reader";
import { utf8 } from "../packages/decoder/src/base/text";
import { parseJson } from "../packages/decoder/src/reel/json";
import { decodeCloud, decodeTrack } from "./reader";

/** Milliseconds that a reel may take; far more than it needs. */
const PATIENCE = 120_000;
/** Frames of a reel that are shown at most. */
const MAX_FRAMES = 100;

/** Decode worker of this thread. Video frames are gray. */
class LocalWorker {
  onmessage: ((event: { data: DecodeReply }) => void) | null = null;
  private readonly running = new Map<number, AbortController>();

  postMessage(request: DecodeRequest): void {
    if ("files" in request) return;
    if ("cancel" in request) return this.running.get(request.id)?.abort();
    void this.decode(request).then((reply) => this.onmessage?.({ data: { id: request.id, ...reply } as DecodeReply }));
  }

  terminate(): void {
    for (const controller of this.running.values()) controller.abort();
  }

  private async decode({ id, source, page }: Extract<DecodeRequest, { page: boolean }>): Promise<object> {
    const controller = new AbortController();
    this.running.set(id, controller);
    try {
      const bytes = await download(source, { received: () => undefined, trouble: () => undefined }, controller.signal);
      if (page) return { page: parseJson(utf8(bytes)) };
      return {
        file: await decodeFile(bytes, source.url, (file, kernels) =>
          decodePaper(file, decodeCloud, decodeTrack, kernels),
        ),
        milliseconds: 1,
      };
    } catch (error) {
      return { error: messageOf(error), plain: error instanceof ReelError ? error.plain : "NOT A REEL ERROR" };
    } finally {
      this.running.delete(id);
    }
  }
}

const workers = { files: () => ({}), start: () => new LocalWorker() as unknown as Worker };

/** Return what is wrong with each reel in a folder; null for nothing. */
export async function verdictsOf(folder: string): Promise<Record<string, string | null>> {
  const verdicts: Record<string, string | null> = {};
  for (const name of readdirSync(folder)) verdicts[name] = await verdictOf(join(folder, name), name);
  return verdicts;
}

async function verdictOf(path: string, name: string): Promise<string | null> {
  try {
    const { renditions } = await using(path, name, undefined, async (reel) => reel.info);
    for (const rendition of renditions.length > 0 ? renditions : [undefined])
      await using(path, name, rendition, readAll);
    return null;
  } catch (error) {
    return error instanceof ReelError && error.plain !== "NOT A REEL ERROR"
      ? error.message
      : `NOT A REEL ERROR: ${error instanceof Error ? error.stack : String(error)}`;
  }
}

/** Open a reel, work on it and close it. */
async function using<T>(
  path: string,
  name: string,
  rendition: string | undefined,
  work: (reel: ReelReader) => Promise<T>,
): Promise<T> {
  const files = new LocalFiles(name, (uri) => {
    const file = join(path, uri);
    return statSync(file, { throwIfNoEntry: false })?.isFile()
      ? { blob: new Blob([readFileSync(file)]), deflated: false }
      : null;
  });
  const reel = await ReelReader.open(files, workers, { rendition });
  let timer: ReturnType<typeof setTimeout>;
  const late = new Promise<never>(
    (_, reject) => (timer = setTimeout(() => reject(new Error("it never ends")), PATIENCE)),
  );
  try {
    return await Promise.race([work(reel), late]);
  } finally {
    clearTimeout(timer!);
    reel.close();
  }
}

/** Show a time of each group, which loads its page, and then the group. */
async function readAll(reel: ReelReader): Promise<void> {
  const { fps, start, end } = reel.info;
  const frames = Math.min(Math.round((end - start) * fps), MAX_FRAMES);
  for (let frame = 0; frame < frames; frame++) await reel.frame(start + frame / fps);
  for (const { number } of reel.groups) await reel.group(number);
}
