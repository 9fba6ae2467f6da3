/** Entry point for the other packages of this repository: what they use of the decoder. It may change with every version. */
export { type LoaderEvents, ReelLoader } from "./stream/reel-loader";
export { type DecoderPool, type DecodeWorkers, EARLY, type EarlyFile, type EarlyWorker } from "./stream/decoder-pool";
export { costOf } from "./stream/file-cache";
export type { Stream } from "./stream/stream";
export {
  type Alive,
  clampFrame,
  firstFrameOf,
  groupAt,
  type Moment,
  momentAt,
  overlapOf,
  type Schedule,
  type Shown,
  staticFlags,
  staticWeights,
  weightAt,
} from "./reel/timeline";
export { layersAt } from "./reel/reel-file";
export { addressWithin } from "./reel/json";
export { addressOf, type Camera, type Clearance, isSameReel, type Manifest, sourceOf } from "./reel/manifest";
export { Reel } from "./reel/reel";
export type { Asset, Presentation, Sound, SoundSegment, Thumbnails } from "./reel/presentation";
export {
  add,
  cross,
  dot,
  eyeOf,
  length,
  normalize,
  rotate,
  scale,
  subtract,
  type Vec3,
  viewmatOf,
} from "./base/matrix";
export { DeviceLostError, isReelError, messageOf, PLAIN, plainWords, ReelError } from "./base/errors";
export { failureOf, openWorker, startWorker } from "./files/workers";
export { download } from "./files/download";
export { LocalFiles } from "./files/local-files";
export type { Access, FileRequest, LocalFile } from "./files/source";
export { lightAt } from "./decode/light";
export type { Offsets } from "./decode/offsets";
export type { Gaussians } from "./decode/gaussians";
export type { DecodedFile, DecodedGroup, DecodedLayer } from "./decode/decode-file";
export type { DecodeReply, DecodeRequest } from "./decode/decode-worker";
