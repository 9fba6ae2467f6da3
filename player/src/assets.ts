/** Workers and decoders lie next to this module, or in the page itself. */
import { embeddedPlayerFile } from "./embedded";

export function startWorker(name: string): Worker {
  const inPage = embeddedPlayerFile(name);
  return new Worker(inPage ? URL.createObjectURL(inPage) : new URL(name, import.meta.url));
}
