/** Early requests of the page: text of the manifest at `url` (null if that failed), the poster, and the first worker. */
export interface Prefetched {
  url: string;
  text: Promise<string | null>;
  image: HTMLImageElement;
  worker: Worker | null;
}
