/** Source of a file, and events of its transfer. */

/** A local file. deflated: whether it is compressed, as files in a zip are. */
export interface LocalFile {
  blob: Blob;
  deflated: boolean;
}

/** Address, size and checksum of a file. */
export interface Source {
  url: string;
  /** Size according to the manifest. */
  bytes: number;
  /** Hex digest. */
  sha256: string;
  /** The file itself, if it is local. Nothing is downloaded then. */
  part?: LocalFile | undefined;
}

/** Receives the events of a transfer. */
export interface Watcher {
  /** Bytes received since the last call. */
  received(bytes: number): void;
  /** The transfer is retried. why: reason, to show to people. */
  trouble(why: string): void;
}
