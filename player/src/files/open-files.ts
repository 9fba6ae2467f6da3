/** A reel out of files that people drop or choose: a folder or a zip. Loaded when they do. */
import { ReelError } from "../base/errors";
import { LocalFiles } from "./local-files";
import type { LocalFile } from "./source";
import { filesOfZip } from "./zip";

/** What was dropped: files, and what the browser knows of folders. */
export interface Dropped {
  entries: FileSystemEntry[];
  files: File[];
}

const MANIFEST = "manifest.json";
/** More files than this are not looked through. */
const MOST = 100_000;
const WHAT_TO_GIVE = "Give the folder that reconstruct or encode wrote, with its manifest.json, or a zip of it.";

type Files = Map<string, () => Promise<LocalFile>>;

/** Throws `ReelError` where there is no reel among them. */
export async function openDropped({ entries, files }: Dropped): Promise<LocalFiles> {
  const folder = entries.find((entry) => entry.isDirectory);
  return folder ? reelAmong(await filesOfFolder(folder as FileSystemDirectoryEntry), folder.name) : openFiles(files);
}

/** Of an input for files or for a folder. Throws `ReelError` where there is no reel among them. */
export async function openFiles(list: Iterable<File>): Promise<LocalFiles> {
  const files = [...list];
  const [first] = files;
  if (!first) throw new ReelError(`There is no file. ${WHAT_TO_GIVE}`);
  if (files.length === 1 && !first.webkitRelativePath) {
    if (await isZip(first)) return reelAmong(await filesOfZip(first, first.name), first.name);
    throw new ReelError(`That is not a reel: ${first.name} is ${kindOf(first.name)}. ${WHAT_TO_GIVE}`);
  }
  const found: Files = new Map(files.map((file) => [file.webkitRelativePath || file.name, async () => whole(file)]));
  return reelAmong(found, first.webkitRelativePath.split("/")[0] || "What you chose");
}

/** The reel whose manifest lies least deep, with all the files beside it. */
async function reelAmong(files: Files, name: string): Promise<LocalFiles> {
  const depth = (path: string): number => path.split("/").length;
  const manifests = [...files.keys()].filter((path) => path.split("/").at(-1) === MANIFEST && !path.includes("__MACOSX"));
  manifests.sort((a, b) => depth(a) - depth(b));
  const [manifest, other] = manifests;
  if (manifest === undefined) throw new ReelError(`That is not a reel: ${name} holds no ${MANIFEST}. ${WHAT_TO_GIVE}`);
  if (other !== undefined && depth(other) === depth(manifest)) throw new ReelError(`${name} holds several reels: ${manifest} and ${other}. Give one of them.`);
  const folder = manifest.slice(0, -MANIFEST.length);
  const parts = new Map<string, LocalFile>();
  for (const [path, read] of files) if (path.startsWith(folder)) parts.set(path.slice(folder.length), await read());
  return new LocalFiles(name, (uri) => parts.get(uri) ?? null);
}

async function filesOfFolder(folder: FileSystemDirectoryEntry): Promise<Files> {
  const found: Files = new Map();
  const look = async (entry: FileSystemEntry, path: string): Promise<void> => {
    if (found.size > MOST) throw new ReelError(`${folder.name} has more than ${MOST} files. ${WHAT_TO_GIVE}`);
    if (entry.isFile) {
      const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
      found.set(path, async () => whole(file));
      return;
    }
    const reader = (entry as FileSystemDirectoryEntry).createReader();
    for (;;) {
      const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
      if (some.length === 0) return; // it gives a hundred at a time
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
  if (["ply", "spz", "splat", "ksplat", "glb", "gltf", "sog"].includes(ending)) return "one still scene, and a reel is a folder of many files";
  if (["mp4", "mov", "webm", "mkv", "avi", "m4v"].includes(ending)) return "an ordinary video, and a reel is made of several by splatreel reconstruct";
  if (ending === "json") return "one file of a reel, and the others belong to it";
  return "a file of another kind";
}
