/** Loads the camera that attributes declare, a part on demand, and follows their changes. */
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";
import type { DeclaredCamera } from "../ui/declared-camera";

/** Attributes that declare a camera. */
const NAMES = [
  "camera-orbit",
  "camera-target",
  "field-of-view",
  "min-camera-orbit",
  "max-camera-orbit",
  "auto-rotate",
  "auto-rotate-delay",
  "rotation-per-second",
];

/** Follow the attributes of an element until the signal. failed: the part cannot be loaded. */
export function watchCamera(host: HTMLElement, player: Player, failed: () => void, signal: AbortSignal): void {
  let loading: Promise<DeclaredCamera> | null = null;
  const update = (): void => {
    if (loading)
      return void loading.then(
        (camera) => signal.aborted || camera.apply(),
        () => undefined,
      );
    if (!NAMES.some((name) => host.hasAttribute(name))) return;
    loading = loadPart("declared-camera.js", () => import("../ui/declared-camera")).then(
      ({ DeclaredCamera }) => new DeclaredCamera(host, player, signal),
    );
    loading.catch(failed);
  };
  const attributes = new MutationObserver(update);
  attributes.observe(host, { attributeFilter: NAMES });
  signal.addEventListener("abort", () => attributes.disconnect());
  update();
}
