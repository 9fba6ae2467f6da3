/** Entry point: defines <splat-reel>, and opens the reel of the bundled page. Without a page, as in Node, it does neither. */
import { SplatReelElement } from "./element/element";
import { openPage, type PageRoot } from "./element/page";

export type { Camera, Manifest } from "@splatreel/decoder/internal";
export { Player } from "./player/player";
export type { Pose } from "./camera/pose";
export type { Picture } from "@splatreel/renderer";
export type { Stats } from "./player/stats";
export { SplatReelElement };

const { customElements, document } = globalThis as Partial<typeof globalThis>;
if (customElements && !customElements.get("splat-reel")) customElements.define("splat-reel", SplatReelElement);

const root = document?.querySelector<PageRoot>("main[data-splatreel-page]");
if (root) openPage(root);
