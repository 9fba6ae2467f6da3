/** Workers and decoders lie next to this module, or in the page itself. */
import { embeddedPlayerFile } from "./embedded";
import { openWorker } from "./worker";

export function startWorker(name: string): Worker {
  const inPage = embeddedPlayerFile(name);
  return inPage ? new Worker(URL.createObjectURL(inPage)) : openWorker(new URL(name, import.meta.url));
}
