/** Entry point: reels in PlayCanvas scenes. */
export { ReelError } from "@splatreel/decoder/base/errors";
export { SplatReel, type SplatReelProperties } from "./splat-reel";
