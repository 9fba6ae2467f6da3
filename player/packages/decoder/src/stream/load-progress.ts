/** Progress of the files that playback waits for. */

/** Returns the size of a file, by its key, and the bytes received. */
export type Measure = (key: string) => { bytes: number; here: number };

/** Sums over all files of the present wait. */
export class LoadProgress {
  private readonly keys = new Set<string>();

  /** Set the needed and the missing files. Files that arrive during a wait count until none is missing. */
  expect(needed: string[], missing: string[]): void {
    if (missing.length === 0) this.keys.clear();
    for (const key of this.keys) if (!needed.includes(key)) this.keys.delete(key);
    for (const key of missing) this.keys.add(key);
  }

  /** Return the received part, 0 to 1. */
  progress(measure: Measure): number {
    const files = [...this.keys].map(measure);
    const total = files.reduce((sum, { bytes }) => sum + bytes, 0);
    return total > 0 ? files.reduce((sum, { bytes, here }) => sum + Math.min(here, bytes), 0) / total : 1;
  }
}
