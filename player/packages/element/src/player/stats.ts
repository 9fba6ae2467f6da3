/** Statistics of the player. */
import type { Resolution, Stage } from "@splatreel/renderer";
import { type DecoderPool, firstFrameOf, type Manifest, type Moment, type Stream } from "@splatreel/decoder/internal";

/** The statistics. */
export interface Stats {
  /** Frames per second, while anything moves. */
  fps: number;
  /** Number of points drawn. */
  points: number;
  width: number;
  height: number;
  /** The rendition on screen; null for a reel without renditions. */
  rendition: string | null;
  /** Bits per second of the present group, and of the network. */
  bitrate: number;
  throughput: number;
  /** Buffered seconds after the present time. */
  ahead: number;
  /** Durations of the last decoding and the last sort. */
  decodeMilliseconds: number;
  sortMilliseconds: number;
}

/** Sources of the statistics. */
export interface Measured {
  stage: Stage;
  stream: Stream;
  decoders: DecoderPool;
  manifest: Manifest;
  canvas: HTMLCanvasElement;
  resolution: Resolution;
  rendition: string | null;
  ahead: number;
  moment: Moment | null;
}

/** Return the statistics. */
export function measure({
  stage,
  stream,
  decoders,
  manifest,
  canvas,
  resolution,
  rendition,
  ahead,
  moment,
}: Measured): Stats {
  const { groups, fps, frames } = manifest;
  const group = moment && groups[moment.current.group];
  const seconds = group ? ((firstFrameOf(manifest, group.group + 1) ?? frames) - group.firstFrame) / fps : 1;
  return {
    fps: 1000 / resolution.interval,
    points: stage.points,
    width: canvas.width,
    height: canvas.height,
    rendition,
    bitrate: group ? (8 * stream.fileOf(group.group).bytes) / seconds : 0,
    throughput: decoders.meter.rate,
    ahead,
    decodeMilliseconds: decoders.milliseconds,
    sortMilliseconds: stage.sortMilliseconds,
  };
}
