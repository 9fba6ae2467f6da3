/** Starting workers, also from another origin, such as that of a CDN. */

declare const self: { location: Location; playerFiles?: string };

/**
 * Browsers start workers of the page's own origin only, so a script of another one is loaded by a small worker made here. On its
 * own origin a player needs no `blob:` in a page's policy.
 */
export function openWorker(address: URL): Worker {
  if (address.origin === self.location.origin) return new Worker(address);
  const [base, script] = [new URL(".", address), address].map((url) => JSON.stringify(url.href));
  const made = URL.createObjectURL(new Blob([`self.playerFiles=${base};importScripts(${script})`], { type: "text/javascript" }));
  const worker = new Worker(made);
  worker.addEventListener("message", () => URL.revokeObjectURL(made), { once: true });
  return worker;
}

/** In a worker: the address of a file beside its script. */
export function besideWorker(name: string): URL {
  return new URL(name, self.playerFiles ?? self.location.href);
}

/** What a worker's error event says; one whose script cannot be loaded says nothing. */
export function failureOf(event: ErrorEvent): string {
  return event.message || "its script cannot be loaded";
}
