/** The page: opens the reel that ?src= names, by default the one beside it. As a module: defines <splat-reel>. */
import { SplatReelElement } from "./element";

export { Player } from "./player";
export { SplatReelElement };

if (!customElements.get("splat-reel")) customElements.define("splat-reel", SplatReelElement);

/** The bundled page asks for a whole-window player; a page that embeds the element does not. */
const stage = document.querySelector("main[data-splatreel-page]");
if (stage) {
  const parameters = new URLSearchParams(location.search);
  const reel = document.createElement("splat-reel");
  for (const name of ["autoplay", "loop", "controls"]) if (parameters.get(name) !== "0") reel.setAttribute(name, "");
  reel.setAttribute("src", parameters.get("src") ?? "reel/manifest.json");
  stage.append(reel);
}
