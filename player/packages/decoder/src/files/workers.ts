/** Starts workers, also from another origin such as a CDN, and in sandboxed frames. */

/** Addresses of the player's files by name. Only the page's module knows them, since bundlers rename files. */
export type FileAddresses = Record<string, string>;

/**
 * Start a worker. Browsers start only workers of the page's own origin. For another origin, and in sandboxed frames, a small `blob:`
 * worker imports the script.
 */
export function openWorker(address: string, start = (): Worker => new Worker(address, { type: "module" })): Worker {
  try {
    return start();
  } catch {
    return importingWorker(address);
  }
}

/** Start a worker that imports a script and queues messages until it has loaded. */
function importingWorker(address: string): Worker {
  const script = `const early=[];onmessage=(e)=>early.push(e);import(${JSON.stringify(address)}).then(()=>early.forEach((e)=>onmessage(e)),(e)=>setTimeout(()=>{throw e}))`;
  const made = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = new Worker(made); // a sandboxed frame cannot start module workers
  worker.addEventListener("message", () => URL.revokeObjectURL(made), { once: true });
  return worker;
}

/** Return the address of a file of the player, in a worker. Unknown files are expected beside its script. */
export function fileAddress(files: FileAddresses, name: string): string {
  return files[name] ?? new URL(name, self.location.href).href;
}

/** Return the message of a worker's error event, which is empty if the script could not be loaded. */
export function failureOf(event: ErrorEvent): string {
  return event.message || "its script cannot be loaded";
}
