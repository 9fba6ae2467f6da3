/** Source of a file, how it is requested, and events of its transfer. */
import { PLAIN, ReelError, messageOf } from "../base/errors";

/** A local file. deflated: whether it is compressed, as files in a zip are. */
export interface LocalFile {
  blob: Blob;
  deflated: boolean;
}

/** What a page adds to the request of a file. */
export interface FileRequest {
  /** Address to request instead, such as a signed one. */
  url?: string | undefined;
  headers?: HeadersInit | undefined;
  credentials?: RequestCredentials | undefined;
}

/** How the files of a private reel are requested. The query of the manifest's address goes to all of them anyway. */
export interface Access {
  /** As in `fetch`: "include" sends cookies to other hosts, too. */
  credentials?: RequestCredentials | undefined;
  /** Called with the address of a file before it is requested. */
  request?: ((url: string) => FileRequest | void | Promise<FileRequest | void>) | null | undefined;
}

/** Return the request of a file, in a form that can be sent to a worker. Throws `ReelError` if the page's function fails. */
export async function requestOf(url: string, { credentials, request }: Access): Promise<FileRequest> {
  try {
    const { headers, ...more } = (await request?.(url)) ?? {};
    return { credentials, ...more, headers: Object.fromEntries(new Headers(headers)) };
  } catch (error) {
    throw new ReelError(`${url} cannot be requested: ${messageOf(error)}.`, { plain: PLAIN.refused, cause: error });
  }
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
  /** How it is requested; undefined for a public reel. Workers get `request` instead. */
  access?: Access | undefined;
  request?: FileRequest | undefined;
}

/** Receives the events of a transfer. */
export interface Watcher {
  /** Bytes received since the last call. */
  received(bytes: number): void;
  /** The transfer is retried. why: reason, to show to people. */
  trouble(why: string): void;
}
