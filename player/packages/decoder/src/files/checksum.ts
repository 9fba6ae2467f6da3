/** Checksums of downloaded files. */

/** Return true if bytes have this SHA-256 digest (hex). Browsers compare digests in secure contexts only: https and localhost. */
export async function isIntact(bytes: Uint8Array, sha256: string): Promise<boolean> {
  if (!globalThis.crypto?.subtle) return true;
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes as BufferSource));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("") === sha256;
}
