/** A few hundred steps of fuzz/run.mjs, always the same. */
import { test } from "node:test";
import { fuzz } from "../fuzz/reader";

test("any edited file decodes or raises a ReelError that names it", async () => {
  let state = 1;
  const random = (below: number): number => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
  for (let i = 0; i < 300; i++) {
    const program = Buffer.from([i % 10, ...Array.from({ length: random(40) }, () => random(256))]);
    try {
      await fuzz(program);
    } catch (error) {
      throw new Error(`program ${program.toString("hex")}`, { cause: error });
    }
  }
});
