/** As a module: defines <splat-reel>. In the bundled page: opens its reel. */
import { SplatReelElement } from "./element";
import { openPage, type Stage } from "./page";

export type { Camera, Manifest } from "./manifest";
export { Player } from "./player";
export type { Pose } from "./pose";
export type { Picture } from "./stage";
export type { Stats } from "./stats";
export { SplatReelElement };

if (!customElements.get("splat-reel")) customElements.define("splat-reel", SplatReelElement);

const stage = document.querySelector<Stage>("main[data-splatreel-page]");
if (stage) openPage(stage);
