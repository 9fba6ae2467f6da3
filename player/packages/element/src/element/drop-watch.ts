/** Loads the drop target, a part on demand, once the reel is drawn or has failed, or people drag something over the element. */
import { loadPart } from "@splatreel/renderer";
import type { FileDrop, FileDropHost } from "../ui/file-drop";

/** Accept drops on an element until the signal. failed: the part cannot be loaded. */
export function watchDrops(host: FileDropHost, root: ShadowRoot, failed: () => void, signal: AbortSignal): void {
  let loading: Promise<FileDrop> | null = null;
  const target = (): Promise<FileDrop> =>
    (loading ??= loadPart("file-drop.js", () => import("../ui/file-drop")).then(
      ({ FileDrop }) => new FileDrop(host, root, signal),
    ));
  const load = (): void => void target().catch(failed);
  for (const name of ["loadeddata", "error"]) host.player.addEventListener(name, load, { signal, once: true });
  host.addEventListener("dragenter", load, { signal, once: true });
  host.addEventListener("dragover", (event) => event.preventDefault(), { signal });
  host.addEventListener(
    "drop",
    (event) => {
      const { dataTransfer } = event;
      if (!dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      // Both are valid only during the event.
      const entries = [...dataTransfer.items].flatMap((item) => item.webkitGetAsEntry?.() ?? []);
      const files = [...dataTransfer.files];
      void target().then((drop) => drop.take(entries, files), failed);
    },
    { signal },
  );
}
