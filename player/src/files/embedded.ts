/** Files in the page itself, in elements that it does not run: one HTML file is then a player with its reel. */
import { LocalFiles } from "./local-files";

/** The address of the reel that is part of the page. */
export const EMBEDDED = "embedded:";

/** Its manifest is the text of #splatreel-manifest, its files are base64 in <script type="text/plain" data-reel-file="PATH">. */
export function embeddedReel(): LocalFiles {
  return new LocalFiles("page", (uri) => {
    const manifest = uri === "manifest.json" ? document.getElementById("splatreel-manifest")?.textContent : null;
    const blob = manifest ? new Blob([manifest]) : embedded("reel", uri);
    return blob && { blob, deflated: false };
  });
}

/** A file of the player that is part of the page, <script type="text/plain" data-player-file="NAME">; null: there is none. */
export function embeddedPlayerFile(name: string): Blob | null {
  return embedded("player", name);
}

function embedded(kind: "reel" | "player", name: string): Blob | null {
  const text = document.querySelector(`script[data-${kind}-file="${CSS.escape(name)}"]`)?.textContent;
  if (!text) return null;
  const type = name.endsWith(".js") ? "text/javascript" : name.endsWith(".wasm") ? "application/wasm" : "";
  return new Blob([Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0))], { type });
}
