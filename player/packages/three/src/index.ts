/** Entry point: reels in three.js scenes. */
export { ReelError } from "@splatreel/decoder/internal";
export { SplatReel, type SplatReelEventMap, type SplatReelOptions } from "./splat-reel";
