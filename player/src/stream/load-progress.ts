/** How much has come of the files that people wait for. */

/** A file by its key: the bytes it has, and those that are here. */
export type Measure = (key: string) => { bytes: number; here: number };

export class LoadProgress {
  private readonly keys = new Set<string>();

  /** Say what is needed and what of it is missing. What came during a wait counts until nothing is missing any more. */
  expect(needed: string[], missing: string[]): void {
    if (missing.length === 0) this.keys.clear();
    for (const key of this.keys) if (!needed.includes(key)) this.keys.delete(key);
    for (const key of missing) this.keys.add(key);
  }

  /** 0..1 */
  progress(measure: Measure): number {
    const files = [...this.keys].map(measure);
    const total = files.reduce((sum, { bytes }) => sum + bytes, 0);
    return total > 0 ? files.reduce((sum, { bytes, here }) => sum + Math.min(here, bytes), 0) / total : 1;
  }
}
