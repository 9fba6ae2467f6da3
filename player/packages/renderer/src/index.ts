/** Entry point: a reel in a scene of any engine, its playback and sound, and the WebGL 2 renderer. */
export { isSameScene, type Scene } from "./draw/scene";
export { frustumOf } from "./draw/frustum";
export { UploadedFiles, type UploadedPoints } from "./draw/uploaded-files";
export { TEXTURE_WIDTH } from "./draw/texture-layout";
export { Sorter } from "./draw/sorter";
export { MOST_REMOVED, type Sphere } from "./draw/cutaway";
export {
  ENTRIES_PER_ROW,
  ENTRY_TEXELS,
  half,
  packCodebook,
  packFlags,
  packPoints,
  POINT_TEXELS,
  rowsOf,
} from "./draw/point-words";
export type { SortReply } from "./draw/sort-worker";
export type { PointSorter } from "./draw/point-sorter";
export type { Picture, Stage } from "./draw/stage";
export type { GraphicsDevice, HeadsetLayer, Renderer } from "./draw/renderer";
export type { Eye } from "./draw/eye";
export { pointGlsl } from "./webgl/point-shaders";
export { coverVertex, splatFragmentOf, splatVertexOf } from "./webgl/shaders";
export { WebglRenderer } from "./webgl/webgl-renderer";
export { WebglDevice } from "./webgl/webgl-device";
export { Program } from "./webgl/program";
export { HeadsetMarks, type Mark, type MarkedEye } from "./webgl/headset-marks";
export { Soundtrack } from "./sound/soundtrack";
export { withMediaProperties } from "./playback/media-properties";
export { type Quality, Resolution } from "./playback/resolution";
export { Session, type SessionEvents } from "./playback/session";
export { PlayPromises } from "./playback/play-promises";
export { ReelPlayer } from "./playback/reel-player";
export { PlayerCore } from "./playback/player-core";
export { PlayedRanges } from "./playback/played-ranges";
export { Playback } from "./playback/playback";
export { Clock } from "./playback/clock";
export { loadPart, playerAddress } from "./files/bundle";
export { waitUntil } from "./base/wait-until";
export { intrinsicsOf, isSameView, type View, viewOfModel } from "./base/view";
export { finite } from "./base/finite";
export { propertiesOf } from "./base/delegation";
