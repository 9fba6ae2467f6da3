/** Whether bytes are those that a manifest speaks of. */

/** sha256: hex digest; null: whatever they are. */
export async function isIntact(bytes: Uint8Array, sha256: string | null): Promise<boolean> {
  // Browsers offer crypto.subtle in secure contexts only: https, and this machine itself.
  if (!sha256 || !globalThis.crypto?.subtle) return true;
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes as BufferSource));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("") === sha256;
}
