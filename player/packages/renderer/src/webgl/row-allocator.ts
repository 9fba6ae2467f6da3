/** First-fit allocator of rows in the splat target. Each file takes a range. */
export class RowAllocator {
  private readonly taken: { first: number; count: number }[] = [];

  /** Allocate `count` rows. Returns the first of them. */
  take(count: number): number {
    let first = 0;
    let at = 0;
    for (; at < this.taken.length && this.taken[at].first - first < count; at++)
      first = this.taken[at].first + this.taken[at].count;
    this.taken.splice(at, 0, { first, count });
    return first;
  }

  /** Free the range that begins at `first`. */
  give(first: number, count: number): void {
    this.taken.splice(
      this.taken.findIndex((range) => range.first === first && range.count === count),
      1,
    );
  }

  /** Number of rows up to the last allocated one. */
  get end(): number {
    const last = this.taken.at(-1);
    return last ? last.first + last.count : 0;
  }
}
