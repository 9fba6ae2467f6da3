/** Load parts on demand, once an element needs them: annotations, a declared camera, drops of files, the media session, tracks. */
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";
import type { Annotations } from "../ui/annotations";
import type { DeclaredCamera } from "../ui/declared-camera";
import type { FileDrop, FileDropHost } from "../ui/file-drop";
import type { Tracks } from "../ui/text-tracks";

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

/** Attributes that declare a camera. */
const NAMES = (
  "camera-orbit camera-target field-of-view min-camera-orbit max-camera-orbit " +
  "auto-rotate auto-rotate-delay rotation-per-second"
).split(" ");

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

/** Show what a player plays on lock screens, until the signal. poster: image of the present reel. */
export function watchMedia(host: HTMLElement, player: Player, poster: HTMLImageElement, signal: AbortSignal): void {
  const { mediaSession } = navigator;
  if (!mediaSession) return;
  player.addEventListener(
    "playing",
    () => {
      const loading = loadPart("media-controls.js", () => import("../ui/media-controls"));
      // Playback goes on without it.
      loading.then(
        ({ MediaControls }) => void (signal.aborted || new MediaControls(host, player, poster, mediaSession, signal)),
        () => undefined,
      );
    },
    { once: true, signal },
  );
}

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
