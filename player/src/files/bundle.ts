/** Workers, decoders and parts that are loaded when they are asked for lie next to this module, or in the page itself. */
import { embeddedPlayerFile } from "./embedded";
import { openWorker } from "./workers";

export function startWorker(name: string): Worker {
  const inPage = embeddedPlayerFile(name);
  return inPage ? new Worker(URL.createObjectURL(inPage)) : openWorker(new URL(name, import.meta.url));
}

/** The address of a file of the player. */
export function moduleAddress(name: string): string {
  const inPage = embeddedPlayerFile(name);
  return inPage ? URL.createObjectURL(inPage) : new URL(name, import.meta.url).href;
}

/** A module of the player that is loaded when it is first needed. */
export function loadModule<T>(name: string): Promise<T> {
  return import(moduleAddress(name)) as Promise<T>;
}
