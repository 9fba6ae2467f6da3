/** What `early` has asked for: the text of the manifest at an address, null if that failed; the poster; the first worker. */
export interface Prefetched {
  url: string;
  text: Promise<string | null>;
  image: HTMLImageElement;
  worker: Worker | null;
}
