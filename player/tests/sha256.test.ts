import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import { isIntact } from "../packages/decoder/src/files/checksum";
import { sha256 } from "../packages/decoder/src/files/sha256";

const bytesOf = (length: number): Uint8Array => Uint8Array.from({ length }, (_, i) => (i * 7919 + (i >> 3)) & 255);

test("the digest of messages of every length around a block is that of Node", () => {
  for (const length of [...Array(200).keys(), 65_535, 1_000_003]) {
    const bytes = bytesOf(length);
    assert.equal(sha256(bytes), createHash("sha256").update(bytes).digest("hex"), `${length} bytes`);
    assert.equal(
      sha256(bytesOf(length + 5).subarray(5)),
      createHash("sha256")
        .update(bytesOf(length + 5).subarray(5))
        .digest("hex"),
    );
  }
});

test("files are compared with their digest where crypto.subtle is missing, as on plain http", async () => {
  const bytes = bytesOf(1000);
  const digest = createHash("sha256").update(bytes).digest("hex");
  const known = Object.getOwnPropertyDescriptor(globalThis, "crypto")!;
  for (const crypto of [globalThis.crypto, {}, undefined]) {
    Object.defineProperty(globalThis, "crypto", { value: crypto, configurable: true });
    try {
      assert.deepEqual([await isIntact(bytes, digest), await isIntact(bytes.with(3, 9), digest)], [true, false]);
    } finally {
      Object.defineProperty(globalThis, "crypto", known);
    }
  }
});
