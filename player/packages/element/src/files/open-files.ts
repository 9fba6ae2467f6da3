/** Opens a reel from files that people drop or choose: a folder or a zip. This part is loaded on demand. */
import { type LocalFile, LocalFiles, ReelError } from "@splatreel/decoder/internal";
import { filesOfZip } from "./zip";

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
