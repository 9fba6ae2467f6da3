/** Within the bundled page, before the player is here: asks for the manifest, and shows the reel's poster. */
import type { Early, Stage } from "./page";

/** Later than this, milliseconds after people came, the line is slow: the player waits until the poster is here. */
const SLOW = 150;
/** But no longer than this. */
const PATIENCE = 2500;
/** A manifest that takes longer than this has stalled. */
const STALL = 8000;

const stage = document.querySelector<Stage>("main[data-splatreel-page]")!;
const parameters = new URLSearchParams(location.search);
const given = parameters.get("poster");
const url = new URL(parameters.get("src") ?? stage.dataset.src ?? "reel/manifest.json", document.baseURI).href;
// Where it fails, the player asks again and says what is wrong.
const text = fetch(url, { cache: "no-cache", priority: "high", signal: AbortSignal.timeout(STALL) }).then((answer) => (answer.ok ? answer.text() : null)).catch(() => null);
const image = document.createElement("img");
const early: Early = { url, text, image, worker: null };
stage.early = early;

function begin(): void {
  early.worker = new Worker(new URL("./decode-worker.js", import.meta.url));
  void import("./player.js");
}

const poster = show().catch(() => undefined);
if (performance.now() < SLOW) begin();
else void Promise.race([poster, new Promise((resolve) => setTimeout(resolve, PATIENCE))]).then(begin);

/** Resolves when the poster is there, or there is none. */
async function show(): Promise<void> {
  const { uri } = given ? { uri: given } : ((JSON.parse((await text) ?? "{}").poster ?? {}) as { uri?: unknown });
  if (typeof uri !== "string" || customElements.get("splat-reel")) return; // the player does it
  image.alt = "";
  image.fetchPriority = "high";
  Object.assign(image.style, { position: "fixed", inset: "0", width: "100%", height: "100%", objectFit: "cover" });
  image.src = new URL(uri, given ? document.baseURI : url).href;
  stage.append(image);
  await image.decode();
}
