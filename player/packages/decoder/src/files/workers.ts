/** Starts workers, also from another origin such as a CDN, and in sandboxed frames. */

/** Addresses of the player's files by name. Only the page's module knows them, since bundlers rename files. */
export type FileAddresses = Record<string, string>;

/** Part of Trusted Types that TypeScript does not describe. */
interface ScriptPolicy {
  createScriptURL(address: string): string;
}
interface PolicyFactory {
  createPolicy(name: string, rules: ScriptPolicy): ScriptPolicy;
}

/** Policy of Trusted Types; null if the browser lacks them or the page does not allow it, undefined before the first worker. */
let policy: ScriptPolicy | null | undefined;

/** Return the policy `splatreel`. A page that requires Trusted Types starts workers only at addresses that a policy made. */
function scriptPolicy(): ScriptPolicy | null {
  if (policy !== undefined) return policy;
  const { trustedTypes } = globalThis as { trustedTypes?: PolicyFactory };
  try {
    policy = trustedTypes?.createPolicy("splatreel", { createScriptURL: (address) => address }) ?? null;
  } catch {
    policy = null;
  }
  return policy;
}

/** Start a worker at an address of the player's own. Throws if the page does not allow it. */
export function startWorker(address: string, options?: WorkerOptions): Worker {
  return new Worker(scriptPolicy()?.createScriptURL(address) ?? address, options);
}

/**
 * Start a module worker. Browsers start only workers of the page's own origin. For another origin, and in sandboxed frames, a small
 * `blob:` worker imports the script. start: the same in the form that bundlers find; small scripts that they embed as `data:` start so.
 */
export function openWorker(address: string, start?: () => Worker): Worker {
  try {
    return start && (address.startsWith("data:") || !scriptPolicy())
      ? start()
      : startWorker(address, { type: "module" });
  } catch {
    return importingWorker(address);
  }
}

/** Start a worker that imports a script and queues messages until it has loaded. */
function importingWorker(address: string): Worker {
  const script = `const early=[];onmessage=(e)=>early.push(e);import(${JSON.stringify(address)}).then(()=>early.forEach((e)=>onmessage(e)),(e)=>setTimeout(()=>{throw e}))`;
  const made = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = startWorker(made); // a sandboxed frame cannot start module workers
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
