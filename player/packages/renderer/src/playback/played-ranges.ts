/** Played ranges of a reel, as `played` of HTMLMediaElement. */

/** Maximum gap in seconds between ranges that are joined. */
const GAP = 1e-3;

/** Sorted, disjoint time ranges. */
export class PlayedRanges {
  /** [start, end] in seconds. */
  private list: [number, number][] = [];

  get ranges(): readonly [number, number][] {
    return this.list;
  }

  add(from: number, to: number): void {
    if (to <= from) return;
    const apart = this.list.filter(([start, end]) => start > to + GAP || end < from - GAP);
    const joined = this.list.filter((range) => !apart.includes(range));
    const whole: [number, number] = [
      Math.min(from, ...joined.map(([start]) => start)),
      Math.max(to, ...joined.map(([, end]) => end)),
    ];
    this.list = [...apart, whole].sort((a, b) => a[0] - b[0]);
  }

  clear(): void {
    this.list = [];
  }
}
