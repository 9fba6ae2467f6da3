/** Live reels: their manifest grows. */
import { loadManifest, type Manifest } from "../reel/manifest";

/** Milliseconds between two looks at a live reel's manifest. */
const POLL = 3000;

/** Wait until a reel has more groups, or less of the first ones, or is whole; its manifest then. A host that fails is asked again. */
export async function nextManifest(manifest: Manifest, signal: AbortSignal): Promise<Manifest> {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, POLL));
    const next = await freshManifest(manifest, signal);
    signal.throwIfAborted();
    if (next && (next.groups.length > manifest.groups.length || next.first > manifest.first || !next.live)) return next;
  }
}

/** A reel's manifest as it is now; null: it cannot be had. */
export function freshManifest({ url }: Manifest, signal: AbortSignal): Promise<Manifest | null> {
  return loadManifest(url, { received: () => undefined, trouble: () => undefined }, signal).catch(() => null);
}

/** Tell of each manifest of a live reel that has other groups than the one before, until the reel is whole. */
export async function watchManifest(manifest: Manifest, grown: (next: Manifest) => void, signal: AbortSignal): Promise<void> {
  let known = manifest;
  while (known.live) {
    const next = await nextManifest(known, signal).catch(() => null);
    if (next === null) return;
    known = next;
    grown(next);
  }
}
