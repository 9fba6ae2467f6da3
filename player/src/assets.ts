/** Workers, decoders and parts that are loaded when they are asked for lie next to this module, or in the page itself. */
import { embeddedPlayerFile } from "./embedded";
import { openWorker } from "./worker";

export function startWorker(name: string): Worker {
  const inPage = embeddedPlayerFile(name);
  return inPage ? new Worker(URL.createObjectURL(inPage)) : openWorker(new URL(name, import.meta.url));
}

/** Of a part that is loaded when it is asked for. */
export function moduleAddress(name: string): string {
  const inPage = embeddedPlayerFile(name);
  return inPage ? URL.createObjectURL(inPage) : new URL(name, import.meta.url).href;
}
