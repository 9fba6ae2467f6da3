/** First script of the bundled page: requests the manifest and the first layer, and shows the poster, before the player is loaded. */
import {
  addressWithin,
  type DecodeReply,
  type DecodeRequest,
  EARLY,
  type EarlyFile,
  type EarlyWorker,
  startWorker,
} from "@splatreel/decoder/internal";
import type { Prefetched } from "../player/prefetched";
import type { PageRoot } from "./page";

/** Milliseconds of page load above which the connection is slow, so that the poster is loaded first. */
const SLOW = 150;
/** Maximum milliseconds for which the player waits for the poster. */
const POSTER_TIMEOUT = 2500;
/** Milliseconds after which the page shows that it loads. The player then shows it itself. */
const SPINNER_AFTER = 400;
/** Milliseconds after which the page says that the player is late. */
const LATE = 20_000;
const LACKING =
  location.protocol === "file:"
    ? "Browsers load no player from a disk. Open the reel by: splatreel view REEL. Or make one file of it, which plays from a disk: splatreel export REEL --out reel.html"
    : "The player cannot be loaded: player.js does not arrive, or does not run in this browser. Reload the page, or update the browser.";
/** Timeout of the manifest, in milliseconds. */
const STALL = 8000;

/** Entry of a layer in the manifest, not checked yet. */
interface Layer {
  uri: unknown;
  bytes: number;
  sha256: unknown;
  group: unknown;
  until?: unknown;
}

const root = document.querySelector<PageRoot>("main[data-splatreel-page]")!;
const parameters = new URLSearchParams(location.search);
const given = parameters.get("poster");
const url = new URL(parameters.get("src") ?? root.dataset.src ?? "reel/manifest.json", document.baseURI).href.split(
  "#",
)[0];
const credentials = parameters.get("crossorigin") === "use-credentials" ? "include" : "same-origin";
// If this fails, the player repeats the request and reports the error.
const text = fetch(url, { cache: "no-cache", credentials, priority: "high", signal: AbortSignal.timeout(STALL) })
  .then((answer) => (answer.ok ? answer.text() : null))
  .catch(() => null);
const image = document.createElement("img");
const spinner = document.createElement("div");
const prefetched: Prefetched = { url, text, image, spinner, worker: null };
root.prefetched = prefetched;

/** Load the player. */
function loadPlayer(): void {
  import("./player.js").catch(() => explain(LACKING));
}

/** Load the player and start its first worker, unless the player has started one. */
function loadAll(): void {
  loadPlayer();
  if (!customElements.get("splat-reel")) prefetched.worker ??= firstWorker();
}

/** Start the first worker and request the first layer; null in a sandboxed frame, where the player starts workers differently. */
function firstWorker(): EarlyWorker | null {
  try {
    const early: EarlyWorker = {
      worker: startWorker(new URL("./decode-worker.js", import.meta.url).href, { type: "module" }),
      file: null,
    };
    void text
      .then((json) => (early.file = requestLayer(early.worker, JSON.parse(json ?? "{}"))))
      .catch(() => undefined);
    return early;
  } catch {
    return null;
  }
}

/** Request the first layer, if it is needed at any time of the reel. The player takes the replies. */
function requestLayer(worker: Worker, manifest: { layers?: Layer[] }): EarlyFile | null {
  const layer = manifest.layers?.[0];
  if (layer?.group !== 0 || layer.until !== undefined || typeof layer.sha256 !== "string") return null;
  const { bytes, sha256 } = layer;
  const file: EarlyFile = { url: addressWithin(url, layer.uri), replies: [] };
  worker.onmessage = ({ data }: MessageEvent<DecodeReply>) => file.replies.push({ data, at: performance.now() });
  worker.postMessage({
    id: EARLY,
    source: { url: file.url, bytes, sha256, request: { credentials } },
    page: false,
  } satisfies DecodeRequest);
  return file;
}

const late = "The player is late: player.js has not arrived yet. Check the network, or reload the page.";
const timers = [setTimeout(showSpinner, SPINNER_AFTER), setTimeout(() => explain(late), LATE)];
const asked = performance.now();
const poster = showPoster().catch(() => undefined);
if (asked < SLOW) loadAll();
else {
  // The poster has about 20 KB. The player is requested a little later, so that it arrives after the poster.
  void text.then(() => setTimeout(loadPlayer, (performance.now() - asked) / 2));
  void poster.then(loadAll);
  setTimeout(loadPlayer, POSTER_TIMEOUT);
}

/** Show the poster. Resolves when it is decoded or there is none. */
async function showPoster(): Promise<void> {
  const address = given ? new URL(given, document.baseURI).href : await ownPoster();
  if (!address || customElements.get("splat-reel")) return; // the player shows it
  image.alt = "";
  image.fetchPriority = "high";
  Object.assign(image.style, { position: "fixed", inset: "0", width: "100%", height: "100%", objectFit: "cover" });
  image.src = address;
  root.append(image);
  await image.decode();
}

/** Show that the page loads, unless the player is here, by the spinner of ui.css. */
function showSpinner(): void {
  const wheel = document.createElement("div");
  Object.assign(wheel.style, { boxSizing: "border-box", width: "42px", height: "42px", borderRadius: "50%" });
  Object.assign(wheel.style, { border: "3px solid rgb(160 160 170 / 0.4)", borderTopColor: "#fff" });
  Object.assign(wheel.style, { background: "rgb(0 0 0 / 0.35)", boxShadow: "0 0 0 3px rgb(0 0 0 / 0.35)" });
  if (show(wheel)) wheel.animate({ rotate: "1turn" }, { duration: 900, iterations: Infinity });
}

/** Say why there is no player, unless it is here. */
function explain(words: string): void {
  timers.forEach(clearTimeout);
  const text = document.createElement("p");
  text.textContent = words;
  text.role = "alert";
  Object.assign(text.style, {
    maxWidth: "40em",
    margin: "16px",
    padding: "8px 16px",
    borderRadius: "10px",
    color: "#fff",
  });
  Object.assign(text.style, { background: "rgb(0 0 0 / 0.72)", font: "15px/1.4 system-ui, sans-serif" });
  show(text);
}

/** Show an element in the middle until the player is here. Returns false if it is. */
function show(element: HTMLElement): boolean {
  if (customElements.get("splat-reel")) return false;
  Object.assign(spinner.style, { position: "fixed", inset: "0", zIndex: "1", display: "grid", placeItems: "center" });
  spinner.replaceChildren(element);
  root.append(spinner);
  return true;
}

/** Return the address of the poster that the manifest names; "" if it names none. Throws `ReelError` for an address outside of the reel. */
async function ownPoster(): Promise<string> {
  const { poster } = JSON.parse((await text) ?? "{}") as { poster?: { uri: unknown } | null };
  return poster ? addressWithin(url, poster.uri) : "";
}
