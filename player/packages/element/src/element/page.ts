/** The bundled page: opens the reel of ?src=, by default the one beside the page, in the whole window. */
import type { Prefetched } from "../player/prefetched";
import { bestLanguage } from "../ui/language";
import styles from "./page.css";

/** Milliseconds until the player shows that it loads. */
const SPINNER = 450;

/** Main element of the bundled page, with its early requests. */
export type PageRoot = HTMLElement & { prefetched?: Prefetched };

/** Fill the page with an element for its reel. */
export function openPage(root: PageRoot): void {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(styles);
  document.adoptedStyleSheets.push(sheet); // a host's policy may forbid style elements
  document.documentElement.lang = bestLanguage(navigator.languages);
  const parameters = new URLSearchParams(location.search);
  const reel = document.createElement("splat-reel");
  for (const name of ["autoplay", "loop", "controls", "share"])
    reel.toggleAttribute(name, parameters.get(name) !== "0");
  reel.toggleAttribute("muted", parameters.get("muted") === "1");
  for (const name of ["src", "poster", "crossorigin"])
    if (parameters.has(name)) reel.setAttribute(name, parameters.get(name)!);
  if (!parameters.has("src")) reel.setAttribute("src", root.dataset.src ?? "reel/manifest.json");
  // A page without a reel asks people for one.
  reel.setAttribute("drop", parameters.has("src") || root.dataset.src ? "" : "ask");
  const heading = document.createElement("h1"); // for screen readers
  heading.textContent = document.title;
  reel.addEventListener("loadedmetadata", () => {
    const { title } = reel.player.manifest!.presentation;
    if (title) heading.textContent = document.title = title;
  });
  if (root.prefetched) reel.player.offer(root.prefetched);
  root.append(heading, reel);
  root.prefetched?.image.remove(); // the element now shows the poster
  const removeSpinner = (): void => root.prefetched?.spinner.remove();
  reel.addEventListener("canplay", removeSpinner);
  setTimeout(removeSpinner, SPINNER);
}
