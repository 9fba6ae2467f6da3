/** Lines of the statistics overlay. This part is loaded on demand. */
import type { Stats } from "../player/stats";

/** Return a name and a text per line of the overlay. */
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
