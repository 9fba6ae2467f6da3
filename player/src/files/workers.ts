/** Starting workers, also from another origin, such as that of a CDN, and in frames that have none of their own. */

/** Addresses of the player's files by their names: bundlers rename files, so only the page's module knows them. */
export type FileAddresses = Record<string, string>;

/**
 * Start a worker. A browser starts those of the page's own origin only, and a sandboxed frame has none. A small worker made here then
 * imports the script. On its own origin a player needs no `blob:` in a page's policy.
 */
export function openWorker(address: string, start = (): Worker => new Worker(address, { type: "module" })): Worker {
  try {
    return start();
  } catch {
    return importingWorker(address);
  }
}

/** A worker that imports a script, and keeps what it is sent until then. */
function importingWorker(address: string): Worker {
  const script = `const early=[];onmessage=(e)=>early.push(e);import(${JSON.stringify(address)}).then(()=>early.forEach((e)=>onmessage(e)),(e)=>setTimeout(()=>{throw e}))`;
  const made = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = new Worker(made); // a frame without an origin cannot start a module
  worker.addEventListener("message", () => URL.revokeObjectURL(made), { once: true });
  return worker;
}

/** In a worker: the address of a file of the player; one that it was not told of lies beside its script. */
export function fileAddress(files: FileAddresses, name: string): string {
  return files[name] ?? new URL(name, self.location.href).href;
}

/** What a worker's error event says; one whose script cannot be loaded says nothing. */
export function failureOf(event: ErrorEvent): string {
  return event.message || "its script cannot be loaded";
}
