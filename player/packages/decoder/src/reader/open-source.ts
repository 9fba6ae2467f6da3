/** Where a reel may come from: an address, or a function that returns its files. */
import { LocalFiles } from "../files/local-files";
import type { DecodeWorkers } from "../stream/decoder-pool";
import { ReelReader, type ReelOptions } from "./reel-reader";

/** Returns the file at a path within a reel, such as manifest.json; null if there is none. */
export type ReelFiles = (path: string) => Blob | null;

/** Open a reel. name: of the reel, for messages. Throws `ReelError`. */
export function openSource(
  source: string | URL | ReelFiles,
  workers: DecodeWorkers,
  options?: ReelOptions,
  name = "reel",
): Promise<ReelReader> {
  return ReelReader.open(typeof source === "function" ? localFiles(source, name) : String(source), workers, options);
}

function localFiles(find: ReelFiles, name: string): LocalFiles {
  return new LocalFiles(name, (uri) => {
    const blob = find(uri);
    return blob && { blob, deflated: false };
  });
}
