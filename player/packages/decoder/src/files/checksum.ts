/** Checksums of downloaded files. */
import { sha256 as plainSha256 } from "./sha256";

/** Return true if bytes have this SHA-256 digest (hex). */
export async function isIntact(bytes: Uint8Array, sha256: string): Promise<boolean> {
  return (await digestOf(bytes)) === sha256;
}

/** Return the SHA-256 digest of bytes in hexadecimal. Browsers have `crypto.subtle` in secure contexts only: https and localhost. */
async function digestOf(bytes: Uint8Array): Promise<string> {
  if (!globalThis.crypto?.subtle) return plainSha256(bytes);
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes as BufferSource));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
