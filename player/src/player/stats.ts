/** Numbers on how the player is doing. */
import type { Stage } from "../draw/stage";
import type { Manifest } from "../reel/manifest";
import { firstFrameOf, type Moment } from "../reel/timeline";
import type { DecoderPool } from "../stream/decoder-pool";
import type { Stream } from "../stream/stream";
import type { Resolution } from "./resolution";

export interface Stats {
  /** Pictures a second, while it plays or the view moves. */
  fps: number;
  /** Points that are sorted and drawn. */
  points: number;
  width: number;
  height: number;
  /** What shows, of a reel that there is in several renditions. */
  rendition: string | null;
  /** Bits a second that the reel takes now, and that the network gave last. */
  bitrate: number;
  throughput: number;
  /** Seconds that are here beyond the present time. */
  ahead: number;
  /** The last file's decoding, and the last sort. */
  decodeMilliseconds: number;
  sortMilliseconds: number;
}

/** What the numbers are taken from. */
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

export function measure({ stage, stream, decoders, manifest, canvas, resolution, rendition, ahead, moment }: Measured): Stats {
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

/** A line each for the overlay. */
export function describe(stats: Stats): [string, string][] {
  const megabits = (bits: number): string => `${(bits / 1e6).toFixed(1)} Mbit/s`;
  const milliseconds = (value: number): string => `${value.toFixed(value < 10 ? 1 : 0)} ms`;
  const rendition: [string, string][] = stats.rendition ? [["Quality", stats.rendition]] : [];
  return [
    ["Pictures", `${stats.fps.toFixed(0)} fps, ${stats.width} × ${stats.height}`],
    ["Points", stats.points.toLocaleString("en")],
    ...rendition,
    ["Bitrate", megabits(stats.bitrate)],
    ["Network", stats.throughput > 0 ? megabits(stats.throughput) : "–"],
    ["Buffer", `${stats.ahead.toFixed(1)} s`],
    ["Decode", milliseconds(stats.decodeMilliseconds)],
    ["Sort", milliseconds(stats.sortMilliseconds)],
  ];
}
