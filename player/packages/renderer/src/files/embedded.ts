/** Files embedded in the page, for one HTML file with player and reel. */
import { LocalFiles } from "@splatreel/decoder/internal";

/** Address of the embedded reel. */
export const EMBEDDED = "embedded:";

/** Return the embedded reel: the manifest is the text of #splatreel-manifest, the files are base64 in <script type="text/plain" data-reel-file="PATH">. */
export function embeddedReel(): LocalFiles {
  return new LocalFiles("page", (uri) => {
    const manifest = uri === "manifest.json" ? document.getElementById("splatreel-manifest")?.textContent : null;
    const blob = manifest ? new Blob([manifest]) : embedded("reel", uri);
    return blob && { blob, deflated: false };
  });
}

/** Return an embedded file of the player, <script type="text/plain" data-player-file="NAME">; null if there is none. */
export function embeddedPlayerFile(name: string): Blob | null {
  return embedded("player", name);
}

function embedded(kind: "reel" | "player", name: string): Blob | null {
  const text = document.querySelector(`script[data-${kind}-file="${CSS.escape(name)}"]`)?.textContent;
  if (!text) return null;
  const type = name.endsWith(".js") ? "text/javascript" : name.endsWith(".wasm") ? "application/wasm" : "";
  return new Blob([Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0))], { type });
}
