/** Loads annotations, a part on demand, once an element has children for them, and follows their changes. */
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";
import type { Annotations } from "../ui/annotations";

/** Follow the annotations of an element until the signal. failed: the part cannot be loaded. */
export function watchAnnotations(host: HTMLElement, player: Player, failed: () => void, signal: AbortSignal): void {
  let loading: Promise<Annotations> | null = null;
  const update = (): void => {
    if (loading)
      return void loading.then(
        (annotations) => annotations.read(),
        () => undefined,
      );
    if (!host.querySelector(':scope > [slot^="annotation-"]')) return;
    loading = loadPart("annotations.js", () => import("../ui/annotations")).then(
      ({ Annotations }) => new Annotations(host, host.shadowRoot!, player, signal),
    );
    loading.catch(failed);
  };
  const children = new MutationObserver(update);
  children.observe(host, { childList: true, subtree: true, attributeFilter: ["slot", "data-position", "data-time"] });
  signal.addEventListener("abort", () => children.disconnect());
  update();
}
