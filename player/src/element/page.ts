/** The bundled page: opens the reel that ?src= names, by default the one beside it, in the whole window. */
import type { Prefetched } from "../player/prefetched";
import styles from "./page.css";

/** The element of the page that asks for it; a page that embeds the player has none. */
export type PageRoot = HTMLElement & { prefetched?: Prefetched };

export function openPage(root: PageRoot): void {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(styles);
  document.adoptedStyleSheets.push(sheet); // not a style element, which a host's policy may forbid
  const parameters = new URLSearchParams(location.search);
  const reel = document.createElement("splat-reel");
  for (const name of ["autoplay", "loop", "controls", "share"]) reel.toggleAttribute(name, parameters.get(name) !== "0");
  reel.toggleAttribute("muted", parameters.get("muted") === "1");
  for (const name of ["src", "poster"]) if (parameters.has(name)) reel.setAttribute(name, parameters.get(name)!);
  if (!parameters.has("src")) reel.setAttribute("src", root.dataset.src ?? "reel/manifest.json");
  // Who opens the player alone has no reel beside it.
  reel.setAttribute("drop", parameters.has("src") || root.dataset.src ? "" : "ask");
  const heading = document.createElement("h1"); // for who does not see the picture
  heading.textContent = document.title;
  reel.addEventListener("loadedmetadata", () => {
    const { title } = reel.player.manifest!.presentation;
    if (title) heading.textContent = document.title = title;
  });
  if (root.prefetched) reel.player.offer(root.prefetched);
  root.append(heading, reel);
  root.prefetched?.image.remove(); // the element shows the same
}
