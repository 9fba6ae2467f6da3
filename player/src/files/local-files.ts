/** A reel's files that need no network: dropped on the page by people, or part of the page itself. */
import { PLAIN, ReelError, messageOf } from "../base/errors";
import { isIntact } from "./checksum";
import type { LocalFile, Source, Watcher } from "./source";

/** Bytes of the longest manifest, and of the longest picture, that are read: what is packed may claim to be little. */
const LONGEST_MANIFEST = 16 << 20;
const LONGEST_PICTURE = 64 << 20;

export class LocalFiles {
  private readonly addresses = new Map<string, Promise<string>>();

  /** name: of the folder or the zip, for messages. find: the file at a path within the reel; null: there is none. */
  constructor(readonly name: string, private readonly find: (uri: string) => LocalFile | null) {}

  /** What addresses of the files would be: they stand in messages. */
  get url(): string {
    return `file:///${encodeURIComponent(this.name)}/manifest.json`;
  }

  /** A file; one that is not there has no bytes. */
  part(uri: string): LocalFile {
    return this.find(uri) ?? { blob: new Blob(), deflated: false };
  }

  /** Text of the manifest. Throws `ReelError`. */
  async manifest(): Promise<string> {
    const part = this.find("manifest.json");
    if (!part) throw new ReelError(`${this.name} is not a reel: it has no manifest.json.`, { plain: `${this.name} is not a reel: it has no manifest.json.` });
    try {
      return await (await unpacked(part, LONGEST_MANIFEST)).text();
    } catch (error) {
      throw new ReelError(`The manifest.json of ${this.name} cannot be read: ${messageOf(error)}.`, { cause: error });
    }
  }

  /** An address of a file within this page, for pictures. It lasts until `close`. */
  address(uri: string): Promise<string> {
    const known = this.addresses.get(uri);
    if (known) return known;
    const made = unpacked(this.part(uri), LONGEST_PICTURE).then((blob) => URL.createObjectURL(blob));
    this.addresses.set(uri, made);
    return made;
  }

  /** Give the addresses back. The files stay. */
  close(): void {
    for (const address of this.addresses.values()) address.then((url) => URL.revokeObjectURL(url), () => undefined);
    this.addresses.clear();
  }
}

/** All bytes of a file, checked. Throws `ReelError`. */
export async function readLocalFile({ url, bytes, sha256 }: Source, part: LocalFile, watcher: Watcher): Promise<Uint8Array> {
  const wrong = (why: string, plain = PLAIN.damaged): ReelError => new ReelError(`${url} cannot be read: ${why}.`, { plain });
  const body = new Uint8Array(bytes);
  let filled = 0;
  const reader = streamOf(part).getReader();
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => Promise.reject(wrong(messageOf(error))));
    if (done) break;
    if (filled + value.byteLength > bytes) throw wrong(`it has more than the ${bytes} bytes of the manifest`);
    body.set(value, filled);
    filled += value.byteLength;
    watcher.received(value.byteLength);
  }
  if (filled === 0) throw wrong("it is not there", PLAIN.missing);
  if (filled < bytes) throw wrong(`it ends after ${filled} of ${bytes} bytes`);
  if (!(await isIntact(body, sha256))) throw wrong("its checksum is not the manifest's");
  return body;
}

/** All of it, if it is not longer than this many bytes. */
async function unpacked(part: LocalFile, most: number): Promise<Blob> {
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  const reader = streamOf(part).getReader();
  for (let length = 0; ; ) {
    const { done, value } = await reader.read();
    if (done) return new Blob(chunks);
    length += value.byteLength;
    if (length > most) throw new ReelError(`it is longer than ${most} bytes`);
    chunks.push(value);
  }
}

/** Its bytes as they are inflated. */
function streamOf({ blob, deflated }: LocalFile): ReadableStream<Uint8Array<ArrayBuffer>> {
  const stream = blob.stream();
  return deflated ? stream.pipeThrough(new DecompressionStream("deflate-raw")) : stream;
}
