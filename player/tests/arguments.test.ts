import assert from "node:assert/strict";
import { test } from "node:test";
import {
  DeviceLostError,
  inSection,
  messageOf,
  PLAIN,
  plainWords,
  ReelError,
} from "../packages/decoder/src/base/errors";
import { checkedPose, checkedViewmat } from "../packages/element/src/player/checked-arguments";
import { finite } from "../packages/renderer/src/base/finite";
import { timeText } from "../packages/element/src/ui/time-text";

const VIEWMAT = [0, 0, 1, 5, 0, 1, 0, 6, -1, 0, 0, 7, 0, 0, 0, 1];

test("invalid numbers are rejected by the name of their argument", () => {
  assert.equal(finite(-0.5, "x"), -0.5);
  assert.equal(finite("0.5", "x"), 0.5);
  for (const wrong of [NaN, Infinity, "one", "NaN", null, undefined])
    assert.throws(() => finite(wrong as number, "currentTime"), {
      name: "TypeError",
      message: /currentTime must be a finite number/,
    });
});

test("a pose is a rotation, a translation and intrinsics", () => {
  assert.deepEqual(checkedViewmat(Float32Array.from(VIEWMAT)), VIEWMAT);
  for (const wrong of [
    VIEWMAT.slice(1),
    [...VIEWMAT, 0],
    VIEWMAT.map((v) => 2 * v),
    VIEWMAT.with(0, 1),
    VIEWMAT.with(3, NaN),
    null,
  ])
    assert.throws(() => checkedViewmat(wrong as number[]), TypeError);
  const K = [100, 0, 50, 0, 100, 50, 0, 0, 1];
  assert.deepEqual(checkedPose({ K, viewmat: VIEWMAT }), { K, viewmat: VIEWMAT });
  for (const wrong of [K.with(0, 0), K.with(4, -1), K.slice(1), K.with(2, NaN)])
    assert.throws(() => checkedPose({ K: wrong, viewmat: VIEWMAT }), TypeError);
});

test("viewers see an error in plain words", () => {
  assert.equal(plainWords(new ReelError("x")), PLAIN.damaged);
  assert.equal(plainWords(new ReelError("x", { plain: PLAIN.network })), PLAIN.network);
  assert.match(plainWords(new DeviceLostError()), /graphics device was lost/);
  assert.equal(plainWords(new TypeError("undefined is not a function")), PLAIN.player);
  assert.deepEqual([messageOf(new Error("why")), messageOf("why"), messageOf(3)], ["why", "why", "3"]);
});

test("an error names its section and keeps its cause", async () => {
  const cause = new Error("it is short");
  assert.equal(await inSection("means", () => 3), 3);
  await assert.rejects(
    inSection("means", () => Promise.reject(cause)),
    { name: "ReelError", message: "section means: it is short", cause },
  );
});

test("times are formatted as minutes and seconds", () => {
  assert.deepEqual(
    [0, 9.99, 61, 3600].map((seconds) => timeText(seconds)),
    ["0:00", "0:09", "1:01", "60:00"],
  );
  assert.deepEqual(
    [0.1 + 0.2, 59.95, 2.9999999].map((seconds) => timeText(seconds, true)),
    ["0:00.3", "0:59.9", "0:03.0"],
  );
});
