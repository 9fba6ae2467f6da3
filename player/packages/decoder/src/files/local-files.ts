/** Files of a reel without a network: dropped on the page, or embedded in it. */
import { PLAIN, ReelError, messageOf } from "../base/errors";
import { utf8 } from "../base/text";
import { isIntact } from "./checksum";
import type { LocalFile, Source, Watcher } from "./source";

/** Maximum bytes of a manifest and of an image after decompression. */
export const LONGEST_MANIFEST = 16 << 20;
const LONGEST_PICTURE = 64 << 20;

/** The files of one local reel. */
export class LocalFiles {
  private readonly addresses = new Map<string, Promise<string>>();

  /** name: of the folder or zip, for messages. find: returns the file at a path within the reel, or null. */
  constructor(
    readonly name: string,
    private readonly find: (uri: string) => LocalFile | null,
  ) {}

  /** Address of the manifest, for messages. */
  get url(): string {
    return `file:///${encodeURIComponent(this.name)}/manifest.json`;
  }

  /** Return a file, empty if it does not exist. */
  part(uri: string): LocalFile {
    return this.find(uri) ?? { blob: new Blob(), deflated: false };
  }

  /** Read the text of the manifest. Throws `ReelError`. */
  async manifest(): Promise<string> {
    const part = this.find("manifest.json");
    if (!part)
      throw new ReelError(`${this.name} is not a reel: it has no manifest.json.`, {
        plain: `${this.name} is not a reel: it has no manifest.json.`,
      });
    try {
      return utf8(await (await unpacked(part, LONGEST_MANIFEST)).arrayBuffer());
    } catch (error) {
      throw new ReelError(`The manifest.json of ${this.name} cannot be read: ${messageOf(error)}.`, { cause: error });
    }
  }

  /** Return an object URL of an image, valid until `close`. */
  address(uri: string): Promise<string> {
    const known = this.addresses.get(uri);
    if (known) return known;
    const made = unpacked(this.part(uri), LONGEST_PICTURE).then((blob) => URL.createObjectURL(blob));
    this.addresses.set(uri, made);
    return made;
  }

  /** Revoke the object URLs. */
  close(): void {
    for (const address of this.addresses.values())
      address.then(
        (url) => URL.revokeObjectURL(url),
        () => undefined,
      );
    this.addresses.clear();
  }
}

/** Read a file and verify its size and checksum. Throws `ReelError`. */
export async function readLocalFile(
  { url, bytes, sha256 }: Source,
  part: LocalFile,
  watcher: Watcher,
): Promise<Uint8Array> {
  const wrong = (why: string, plain = PLAIN.damaged): ReelError =>
    new ReelError(`${url} cannot be read: ${why}.`, { plain });
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
  if (filled === 0) throw wrong("it is missing", PLAIN.missing);
  if (filled < bytes) throw wrong(`it ends after ${filled} of ${bytes} bytes`);
  if (!(await isIntact(body, sha256))) throw wrong("its checksum differs from the manifest");
  return body;
}

/** Decompress a file of at most `most` bytes. */
async function unpacked(part: LocalFile, most: number): Promise<Blob> {
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  const reader = streamOf(part).getReader();
  for (let length = 0; ;) {
    const { done, value } = await reader.read();
    if (done) return new Blob(chunks);
    length += value.byteLength;
    if (length > most) throw new ReelError(`it is longer than ${most} bytes`);
    chunks.push(value);
  }
}

/** Return the stream of decompressed bytes. */
function streamOf({ blob, deflated }: LocalFile): ReadableStream<Uint8Array<ArrayBuffer>> {
  const stream = blob.stream();
  return deflated ? stream.pipeThrough(new DecompressionStream("deflate-raw")) : stream;
}
