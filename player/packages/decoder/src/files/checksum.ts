/** Checksums of downloaded files. */

/** Return true if bytes have this SHA-256 digest (hex), or if the page can compute none. */
export async function isIntact(bytes: Uint8Array, sha256: string): Promise<boolean> {
  return [sha256, null].includes(await digestOf(bytes));
}

/**
 * Return the SHA-256 digest of bytes in hexadecimal. Browsers have `crypto.subtle` in secure contexts only; other pages load a script
 * instead. Returns null on a page that holds the whole player, whose workers can load no script beside them.
 */
async function digestOf(bytes: Uint8Array): Promise<string | null> {
  if (!globalThis.crypto?.subtle)
    return import("./sha256").then(
      ({ sha256 }) => sha256(bytes),
      () => null,
    );
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes as BufferSource));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
