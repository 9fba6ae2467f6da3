/** The files in tests/data/hostile lie on purpose; Python refuses the same. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { decodeCloud } from "../fuzz/reader";
import { ReelError } from "../packages/decoder/src/base/errors";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { decodePaper } from "../packages/decoder/src/decode/paper";
import { parseManifest } from "../packages/decoder/src/reel/manifest";

const FOLDER = join(process.cwd(), "../tests/data/hostile");
const never = (): never => assert.fail("no picture of it may be decoded");

for (const name of readdirSync(FOLDER).filter((name) => name.endsWith(".bin"))) {
  test(`${name} is refused`, async () => {
    const data = readFileSync(join(FOLDER, name));
    const read = name.startsWith("manifest")
      ? async () => parseManifest(JSON.parse(data.toString()), "a reel")
      : () =>
          decodeFile(new Uint8Array(data), "a file", (file, kernels) => decodePaper(file, decodeCloud, never, kernels));
    await assert.rejects(read, (error: Error) => {
      let cause: unknown = error;
      while (cause instanceof Error && cause.cause !== undefined) cause = cause.cause;
      assert.ok(error instanceof ReelError && cause instanceof ReelError, String(cause));
      if (!name.startsWith("manifest")) assert.match(error.message, /^a file (is damaged|cannot be played): /);
      return true;
    });
  });
}
