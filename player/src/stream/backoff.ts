/** Files that could not be had, and that nobody waits for, are left alone for a while. */

/** Milliseconds. */
const PAUSE = 10_000;

export class Backoff {
  private readonly until = new Map<string, number>();

  /** A file failed. */
  begin(key: string): void {
    this.until.set(key, performance.now() + PAUSE);
  }

  /** Whether it is too early to ask for a file again. */
  has(key: string): boolean {
    return (this.until.get(key) ?? 0) > performance.now();
  }
}
