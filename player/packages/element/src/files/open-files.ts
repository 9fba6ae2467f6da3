/** Opens a reel from files that people drop or choose: a folder or a zip. This part is loaded on demand. */
import { type LocalFile, LocalFiles, ReelError } from "@splatreel/decoder/internal";

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

/** Dropped files, and the entries of dropped folders. */
export interface Dropped {
  entries: FileSystemEntry[];
  files: File[];
}

const MANIFEST = "manifest.json";
/** Maximum number of files in a folder. */
const MAX_FILES = 100_000;
const REMEDY = "Give the folder that reconstruct or encode wrote, with its manifest.json, or a zip of it.";

type Files = Map<string, () => Promise<LocalFile>>;

/** Open the reel among dropped files. Throws `ReelError` if there is none. */
export async function openDropped({ entries, files }: Dropped): Promise<LocalFiles> {
  const folder = entries.find((entry) => entry.isDirectory);
  return folder ? reelAmong(await filesOfFolder(folder as FileSystemDirectoryEntry), folder.name) : openFiles(files);
}

/** Open the reel among the files of an input element. Throws `ReelError` if there is none. */
export async function openFiles(list: Iterable<File>): Promise<LocalFiles> {
  const files = [...list];
  const [first] = files;
  if (!first) throw new ReelError(`There is no file. ${REMEDY}`);
  if (files.length === 1 && !first.webkitRelativePath) {
    if (await isZip(first)) return reelAmong(await filesOfZip(first, first.name), first.name);
    throw new ReelError(`That is not a reel: ${first.name} is ${kindOf(first.name)}. ${REMEDY}`);
  }
  const found: Files = new Map(files.map((file) => [file.webkitRelativePath || file.name, async () => whole(file)]));
  return reelAmong(found, first.webkitRelativePath.split("/")[0] || "Your choice");
}

/** Return the reel whose manifest is nearest to the root, with the files in its folder. */
async function reelAmong(files: Files, name: string): Promise<LocalFiles> {
  const depth = (path: string): number => path.split("/").length;
  const manifests = [...files.keys()].filter(
    (path) => path.split("/").at(-1) === MANIFEST && !path.includes("__MACOSX"),
  );
  manifests.sort((a, b) => depth(a) - depth(b));
  const [manifest, other] = manifests;
  if (manifest === undefined) throw new ReelError(`That is not a reel: ${name} holds no ${MANIFEST}. ${REMEDY}`);
  if (other !== undefined && depth(other) === depth(manifest))
    throw new ReelError(`${name} holds several reels: ${manifest} and ${other}. Give one of them.`);
  const folder = manifest.slice(0, -MANIFEST.length);
  const parts = new Map<string, LocalFile>();
  for (const [path, read] of files) if (path.startsWith(folder)) parts.set(path.slice(folder.length), await read());
  return new LocalFiles(name, (uri) => parts.get(uri) ?? null);
}

async function filesOfFolder(folder: FileSystemDirectoryEntry): Promise<Files> {
  const found: Files = new Map();
  const look = async (entry: FileSystemEntry, path: string): Promise<void> => {
    if (found.size > MAX_FILES) throw new ReelError(`${folder.name} has more than ${MAX_FILES} files. ${REMEDY}`);
    if (entry.isFile) {
      const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
      found.set(path, async () => whole(file));
      return;
    }
    const reader = (entry as FileSystemDirectoryEntry).createReader();
    for (;;) {
      const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
      if (some.length === 0) return; // readEntries returns a hundred entries at a time
      for (const inside of some) await look(inside, path ? `${path}/${inside.name}` : inside.name);
    }
  };
  await look(folder, "");
  return found;
}

const whole = (file: File): LocalFile => ({ blob: file, deflated: false });

async function isZip(file: File): Promise<boolean> {
  const [a, b] = new Uint8Array(await file.slice(0, 2).arrayBuffer());
  return (a === 0x50 && b === 0x4b) || /\.zip$/i.test(file.name);
}

function kindOf(name: string): string {
  const ending = name.toLowerCase().split(".").at(-1)!;
  if (["ply", "spz", "splat", "ksplat", "glb", "gltf", "sog"].includes(ending))
    return "a single static scene; a reel is a folder of many files";
  if (["mp4", "mov", "webm", "mkv", "avi", "m4v"].includes(ending))
    return "an ordinary video; splatreel reconstruct makes a reel from several videos";
  if (ending === "json") return "only one file of a reel";
  return "a file of another type";
}
