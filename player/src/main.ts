/** As a module: defines <splat-reel>. As the bundled page: opens the reel that ?src= names, by default the one beside it. */
import { SplatReelElement } from "./element";

export type { Camera, Manifest } from "./manifest";
export { Player } from "./player";
export type { Pose } from "./pose";
export type { Picture } from "./stage";
export type { Stats } from "./stats";
export { SplatReelElement };

if (!customElements.get("splat-reel")) customElements.define("splat-reel", SplatReelElement);

/** The bundled page asks for a whole-window player; a page that embeds the element does not. */
const stage = document.querySelector<HTMLElement>("main[data-splatreel-page]");
if (stage) {
  const parameters = new URLSearchParams(location.search);
  const reel = document.createElement("splat-reel");
  for (const name of ["autoplay", "loop", "controls", "share"]) reel.toggleAttribute(name, parameters.get(name) !== "0");
  for (const name of ["src", "poster"]) if (parameters.has(name)) reel.setAttribute(name, parameters.get(name)!);
  if (!parameters.has("src")) reel.setAttribute("src", stage.dataset.src ?? "reel/manifest.json");
  stage.append(reel);
}
