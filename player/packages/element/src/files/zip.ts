/** Reads zip archives: the directory first, and each file on access. */
import { type LocalFile, ReelError } from "@splatreel/decoder/internal";

/** Maximum number of files, and maximum bytes of the directory. */
const MOST_FILES = 100_000;
const MOST_BYTES = 32 << 20;
/** Size of the end record, and maximum size of the comment that follows it. */
const END = 22;
const COMMENT = 0xffff;
const LOCAL_HEADER = 30;
const [STORED, DEFLATED] = [0, 8];

interface Entry {
  name: string;
  method: number;
  encrypted: boolean;
  packed: number;
  header: number;
}

/** Return the files of a zip by path. Throws `ReelError` if it is not a zip or cannot be read. */
export async function filesOfZip(blob: Blob, name: string): Promise<Map<string, () => Promise<LocalFile>>> {
  const wrong = (why: string): ReelError => new ReelError(`${name} cannot be read: ${why}.`);
  const entries = await directoryOf(blob, wrong);
  const files = new Map<string, () => Promise<LocalFile>>();
  for (const { name: path, method, encrypted, packed, header } of entries) {
    if (path.endsWith("/")) continue;
    files.set(path, async () => {
      if (encrypted) throw wrong(`${path} is encrypted. Zip the folder without a password`);
      if (method !== STORED && method !== DEFLATED)
        throw wrong(`${path} is compressed in a way (${method}) that browsers do not know. Zip the folder as usual`);
      const local = await view(blob, header, LOCAL_HEADER);
      if (local.byteLength < LOCAL_HEADER || local.getUint32(0, true) !== 0x04034b50)
        throw wrong(`it is damaged at ${path}. Copy it again`);
      const start = header + LOCAL_HEADER + local.getUint16(26, true) + local.getUint16(28, true);
      return { blob: blob.slice(start, start + packed), deflated: method === DEFLATED };
    });
  }
  return files;
}

async function directoryOf(blob: Blob, wrong: (why: string) => ReelError): Promise<Entry[]> {
  const from = Math.max(blob.size - END - COMMENT, 0);
  const tail = await view(blob, from, blob.size - from);
  let at = tail.byteLength - END;
  while (at >= 0 && tail.getUint32(at, true) !== 0x06054b50) at--;
  if (at < 0) throw wrong("it is not a zip, or it was cut off. Copy it again");
  const [count, size, start] = [
    tail.getUint16(at + 10, true),
    tail.getUint32(at + 12, true),
    tail.getUint32(at + 16, true),
  ];
  if (start === 0xffffffff || count === 0xffff) throw wrong("it is larger than 4 GB. Unzip it and open the folder");
  if (size > MOST_BYTES || start + size > from + at) throw wrong("it is damaged. Copy it again");
  const directory = await view(blob, start, size);
  const entries: Entry[] = [];
  for (let place = 0; entries.length < Math.min(count, MOST_FILES);) {
    if (place + 46 > size || directory.getUint32(place, true) !== 0x02014b50)
      throw wrong("its directory is damaged. Copy it again");
    const u16 = (offset: number): number => directory.getUint16(place + offset, true);
    const u32 = (offset: number): number => directory.getUint32(place + offset, true);
    const end = place + 46 + u16(28);
    if (end > size) throw wrong("its directory is damaged. Copy it again");
    const name = new TextDecoder().decode(new Uint8Array(directory.buffer, place + 46, u16(28))).replaceAll("\\", "/");
    entries.push({ name, method: u16(10), encrypted: (u16(8) & 1) === 1, packed: u32(20), header: u32(42) });
    place = end + u16(30) + u16(32);
  }
  return entries;
}

async function view(blob: Blob, start: number, length: number): Promise<DataView> {
  return new DataView(await blob.slice(start, start + length).arrayBuffer());
}
