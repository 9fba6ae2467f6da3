/** Numbers on how the player is doing. */
import type { Player } from "./player";

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

export function measure(player: Player): Stats {
  const { stage, stream, session, manifest, canvas, resolution, ahead, currentTime } = player;
  const { groups, fps, frames } = manifest!;
  const index = Math.max(groups.findLastIndex((group) => group.firstFrame <= currentTime * fps), 0);
  const seconds = ((groups[index + 1]?.firstFrame ?? frames) - groups[index].firstFrame) / fps;
  return {
    fps: 1000 / resolution.interval,
    points: stage!.points,
    width: canvas.width,
    height: canvas.height,
    rendition: player.shownRendition,
    bitrate: (8 * stream!.fileOf(index).bytes) / seconds,
    throughput: session!.decoders.meter.rate,
    ahead,
    decodeMilliseconds: session!.decoders.milliseconds,
    sortMilliseconds: stage!.sortMilliseconds,
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
