/** Live reels: their manifest grows. */
import { loadManifest, type Manifest } from "../reel/manifest";

/** Milliseconds between two looks at a live reel's manifest. */
const POLL = 3000;

/** Wait until a reel has more groups, or is whole; its manifest then. A host that fails is asked again. */
export async function nextManifest(manifest: Manifest, signal: AbortSignal): Promise<Manifest> {
  const quiet = { received: () => undefined, trouble: () => undefined };
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, POLL));
    const next = await loadManifest(manifest.url, quiet, signal).catch(() => null);
    signal.throwIfAborted();
    if (next && (next.groups.length > manifest.groups.length || !next.live)) return next;
  }
}

/** Tell of each manifest of a live reel that has more than the one before, until the reel is whole. */
export async function watchManifest(manifest: Manifest, grown: (next: Manifest) => void, signal: AbortSignal): Promise<void> {
  let known = manifest;
  while (known.live) {
    const next = await nextManifest(known, signal).catch(() => null);
    if (next === null) return;
    known = next;
    grown(next);
  }
}
