/** Text from bytes. */
import { ReelError } from "./errors";

/** Return the text of UTF-8 bytes. Throws for other bytes. */
export function utf8(bytes: ArrayBuffer | Uint8Array): string {
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    throw new ReelError("it is not UTF-8");
  }
}
