import assert from "node:assert/strict";
import { test } from "node:test";
import { LoadProgress } from "../packages/decoder/src/stream/stream";

const here: Record<string, number> = { layer: 0, group: 0 };
const measure = (key: string): { bytes: number; here: number } => ({ bytes: 100, here: here[key] });

test("bytes received during a wait count until nothing is missing", () => {
  const awaited = new LoadProgress();
  assert.equal(awaited.progress(measure), 1);
  awaited.expect(["layer", "group"], ["layer", "group"]);
  assert.equal(awaited.progress(measure), 0);
  here.layer = 100;
  awaited.expect(["layer", "group"], ["group"]);
  here.group = 50;
  assert.equal(awaited.progress(measure), 0.75);
  here.group = 120; // it began anew
  assert.equal(awaited.progress(measure), 1);
  awaited.expect(["layer", "group"], []);
  assert.equal(awaited.progress(measure), 1);
});

test("progress of another wait begins at 0", () => {
  const awaited = new LoadProgress();
  awaited.expect(["layer", "group"], ["group"]);
  here.group = 0;
  assert.equal(awaited.progress(measure), 0, "the layer was there before");
  awaited.expect(["layer"], []);
  assert.equal(awaited.progress(measure), 1);
});
