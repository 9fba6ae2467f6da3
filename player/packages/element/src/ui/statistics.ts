/** The statistics over the picture. This part is loaded on demand. */
import type { Player } from "../player/player";
import type { Stats } from "../player/stats";
import { elementOf } from "./markup";
import styles from "./statistics.css";
import { adoptStyles } from "./styles";

/** Milliseconds between updates. */
const EVERY = 250;

/** Statistics of one player, hidden at first. */
export class Statistics {
  private readonly box: HTMLElement;

  /** holder: element of all controls. signal: aborted when they are removed. */
  constructor(
    root: ShadowRoot,
    holder: HTMLElement,
    private readonly player: Player,
    signal: AbortSignal,
  ) {
    adoptStyles(root, styles);
    this.box = elementOf(`<dl class="sheet stats" aria-label="Statistics" hidden></dl>`, player.words);
    holder.querySelector(".bar")!.before(this.box);
    const timer = setInterval(() => this.update(), EVERY);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  get shown(): boolean {
    return !this.box.hidden;
  }

  toggle(): void {
    this.box.hidden = this.shown;
    this.update();
  }

  private update(): void {
    const { stats, words } = this.player;
    if (!stats || !this.shown) return;
    const lines = describe(stats).map(([name, value]) => `<dt>${words(name)}</dt><dd>${value}</dd>`);
    this.box.replaceChildren(...elementOf(`<dl>${lines.join("")}</dl>`).children);
  }
}

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
