import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { decodeFile } from "../packages/decoder/src/decode/decode-file";
import { decodePaper } from "../packages/decoder/src/decode/paper";

const golden = new URL("../tests/data/golden/groups/0000.safetensors", `file://${process.cwd()}/`);

/** The golden group, its metadata changed by the same number of bytes. */
function forged(from: string, to: string): Uint8Array {
  const text = readFileSync(golden).toString("latin1");
  assert.ok(text.includes(from) && from.length === to.length, from);
  return new Uint8Array(Buffer.from(text.replace(from, to), "latin1"));
}

const never = (): never => assert.fail("nothing may be decoded");

test("a motion codec of the paper's tables is rejected by name", async () => {
  const file = forged('\\"codec\\":\\"h265\\",', '\\"codec\\":\\"ori\\" ,');
  await assert.rejects(
    decodeFile(file, "groups/0000.safetensors", (paper, kernels) => decodePaper(paper, never, never, kernels)),
    (error: Error) => {
      assert.match(
        error.message,
        /^groups\/0000.safetensors cannot be played: its motion has the codec ori, and this player knows h265/,
      );
      return true;
    },
  );
});
