/** Polls the manifest of a live reel. */
import { hasOtherContents, loadManifest, type Manifest } from "../reel/manifest";

/** Milliseconds between two requests. */
const POLL = 3000;

/** Wait until a reel has new groups, has dropped or replaced some, or is complete, and return its manifest. Failed requests are repeated. */
export async function nextManifest(manifest: Manifest, signal: AbortSignal): Promise<Manifest> {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, POLL));
    const next = await freshManifest(manifest, signal);
    signal.throwIfAborted();
    if (!next) continue;
    if (
      next.groups.length > manifest.groups.length ||
      next.first > manifest.first ||
      !next.live ||
      hasOtherContents(manifest, next)
    )
      return next;
  }
}

/** Request the manifest; null if that fails. */
export function freshManifest({ url, access }: Manifest, signal: AbortSignal): Promise<Manifest | null> {
  return loadManifest(url, { received: () => undefined, trouble: () => undefined }, signal, access).catch(() => null);
}

/** Call `grown` with each new manifest of a live reel, until the reel is complete. */
export async function watchManifest(
  manifest: Manifest,
  grown: (next: Manifest) => void,
  signal: AbortSignal,
): Promise<void> {
  let known = manifest;
  while (known.live) {
    const next = await nextManifest(known, signal).catch(() => null);
    if (next === null) return;
    known = next;
    grown(next);
  }
}
