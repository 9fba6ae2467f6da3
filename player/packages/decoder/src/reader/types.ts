/** The types of the package. */
export type { DecodedFile, DecodedGroup, DecodedLayer } from "../decode/decode-file";
export type { Gaussians } from "../decode/gaussians";
export type { Appearance, Offsets } from "../decode/offsets";
export type { Camera } from "../reel/manifest";
export type { Access, FileRequest } from "../files/source";
export type { ReelFiles } from "./open-source";
export type { GroupData, Points } from "./points";
export type { Frame, GroupInfo, ReelInfo, ReelOptions, ReelReader } from "./reel-reader";
