/** Pauses before retries of failed files that playback does not wait for. */

/** Pause in milliseconds. */
const PAUSE = 10_000;

/** Remembers when each failed file may be requested again. */
export class Backoff {
  private readonly until = new Map<string, number>();

  /** Begin the pause of a file that failed. */
  begin(key: string): void {
    this.until.set(key, performance.now() + PAUSE);
  }

  /** Return true during the pause of a file. */
  has(key: string): boolean {
    return (this.until.get(key) ?? 0) > performance.now();
  }
}
