/** Entry point: reels in PlayCanvas scenes. */
export { ReelError } from "@splatreel/decoder/internal";
export { SplatReel, type SplatReelProperties } from "./splat-reel";
