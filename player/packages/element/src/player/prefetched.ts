import type { EarlyWorker } from "@splatreel/decoder/internal";

/** Early requests of the page: text of the manifest at `url` (null if that failed), the poster, the sign of loading, and the first worker with the first layer. */
export interface Prefetched {
  url: string;
  text: Promise<string | null>;
  image: HTMLImageElement;
  spinner: HTMLElement;
  worker: EarlyWorker | null;
}
