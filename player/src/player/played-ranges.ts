/** The parts of a reel that were played, as `played` of HTMLMediaElement. */

/** Seconds between two ranges that count as none. */
const GAP = 1e-3;

export class PlayedRanges {
  /** [start, end] seconds, in order of time, apart from each other. */
  private list: [number, number][] = [];

  get ranges(): readonly [number, number][] {
    return this.list;
  }

  add(from: number, to: number): void {
    if (to <= from) return;
    const apart = this.list.filter(([start, end]) => start > to + GAP || end < from - GAP);
    const joined = this.list.filter((range) => !apart.includes(range));
    const whole: [number, number] = [Math.min(from, ...joined.map(([start]) => start)), Math.max(to, ...joined.map(([, end]) => end))];
    this.list = [...apart, whole].sort((a, b) => a[0] - b[0]);
  }

  clear(): void {
    this.list = [];
  }
}
