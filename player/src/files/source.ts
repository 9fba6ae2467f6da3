/** Where a file of a reel comes from, and who is told how it comes. */

/** Bytes on this machine; deflated: compressed, as files in a zip are. */
export interface LocalFile {
  blob: Blob;
  deflated: boolean;
}

export interface Source {
  url: string;
  /** What the manifest says the file has. */
  bytes: number;
  /** Hex digest, compared where the page is a secure context; null: not compared. */
  sha256: string | null;
  /** Of a reel on this machine: where the bytes are. Nothing is downloaded then. */
  part?: LocalFile | undefined;
}

export interface Watcher {
  /** Bytes that came since the last call. */
  received(bytes: number): void;
  /** Something went wrong and is being tried again; why, for people. */
  trouble(why: string): void;
}
