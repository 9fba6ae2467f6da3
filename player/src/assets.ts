/** Workers and decoders lie next to this module. */

export function startWorker(name: string): Worker {
  return new Worker(new URL(name, import.meta.url));
}
