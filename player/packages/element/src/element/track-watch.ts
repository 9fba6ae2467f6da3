/** Loads captions and chapters, a part on demand, once an element has `<track>` children, and follows their changes. */
import { loadPart } from "@splatreel/renderer";
import type { Tracks } from "../ui/text-tracks";

/** Follow the tracks of an element until the signal. create: creates the tracks from the loaded part. failed: the part cannot be loaded. */
export function watchTracks(
  host: HTMLElement,
  create: (part: typeof import("../ui/text-tracks")) => Tracks,
  failed: () => void,
  signal: AbortSignal,
): void {
  let tracks: Tracks | null = null;
  let loading = false;
  const update = async (): Promise<void> => {
    if (tracks) return tracks.read();
    if (loading || !host.querySelector(":scope > track[src]")) return;
    loading = true;
    try {
      const part = await loadPart("text-tracks.js", () => import("../ui/text-tracks"));
      if (!signal.aborted) tracks = create(part);
    } catch {
      failed();
    }
  };
  const children = new MutationObserver(() => void update());
  children.observe(host, {
    childList: true,
    subtree: true,
    attributeFilter: ["src", "kind", "srclang", "label", "default"],
  });
  const choice = new MutationObserver(() => tracks?.select());
  choice.observe(host, { attributeFilter: ["captions"] });
  signal.addEventListener("abort", () => {
    children.disconnect();
    choice.disconnect();
    tracks?.remove();
  });
  void update();
}
