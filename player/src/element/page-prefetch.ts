/** Within the bundled page, before the player is here: asks for the manifest, and shows the reel's poster. */
import type { Prefetched } from "../player/prefetched";
import type { PageRoot } from "./page";

/** Later than this, milliseconds after people came, the line is slow: the poster goes first. */
const SLOW = 150;
/** The player waits no longer than this for what says whether there is one. */
const PATIENCE = 2500;
/** A manifest that takes longer than this has stalled. */
const STALL = 8000;

const root = document.querySelector<PageRoot>("main[data-splatreel-page]")!;
const parameters = new URLSearchParams(location.search);
const given = parameters.get("poster");
const url = new URL(parameters.get("src") ?? root.dataset.src ?? "reel/manifest.json", document.baseURI).href.split("#")[0];
// Where it fails, the player asks again and says what is wrong.
const text = fetch(url, { cache: "no-cache", priority: "high", signal: AbortSignal.timeout(STALL) }).then((answer) => (answer.ok ? answer.text() : null)).catch(() => null);
const image = document.createElement("img");
const prefetched: Prefetched = { url, text, image, worker: null };
root.prefetched = prefetched;

/** The player, unless it is asked for already. */
function play(): void {
  void import("./player.js");
}

/** And its first worker, unless the player has started one. */
function begin(): void {
  play();
  if (!customElements.get("splat-reel")) prefetched.worker ??= firstWorker();
}

/** None in a sandboxed frame, where the player has to start it in another way. */
function firstWorker(): Worker | null {
  try {
    return new Worker(new URL("./decode-worker.js", import.meta.url), { type: "module" });
  } catch {
    return null;
  }
}

const asked = performance.now();
const poster = show().catch(() => undefined);
if (asked < SLOW) begin();
else {
  // The poster is some 20 KB: what the player is asked for a little later comes when most of it is there.
  void text.then(() => setTimeout(play, (performance.now() - asked) / 2));
  void poster.then(begin);
  setTimeout(play, PATIENCE);
}

/** Resolves when the poster is there, or there is none. */
async function show(): Promise<void> {
  const { uri } = given ? { uri: given } : ((JSON.parse((await text) ?? "{}").poster ?? {}) as { uri?: unknown });
  if (typeof uri !== "string" || customElements.get("splat-reel")) return; // the player does it
  image.alt = "";
  image.fetchPriority = "high";
  Object.assign(image.style, { position: "fixed", inset: "0", width: "100%", height: "100%", objectFit: "cover" });
  image.src = new URL(uri, given ? document.baseURI : url).href;
  root.append(image);
  await image.decode();
}
