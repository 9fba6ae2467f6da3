import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { eyeOf, length, subtract } from "../packages/decoder/src/base/matrix";
import {
  CameraPath,
  type Keyframe,
  nearestFirst,
  parsePath,
  type PathFile,
} from "../packages/element/src/camera/camera-path";
import { appended, lasting, moved, throughViews, without } from "../packages/element/src/ui/path-panel";

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const at = (x: number, y = 0): number[] => IDENTITY.map((value, i) => (i === 3 ? -x : i === 7 ? -y : value));
const key = (seconds: number, viewmat: number[], time = seconds): Keyframe => ({ at: seconds, time, viewmat });
const x = (path: CameraPath, seconds: number): number => eyeOf(path.at(seconds).viewmat)[0];
const file = (change: object = {}, keyframe: object = {}): unknown => ({
  format: "splatreel-path",
  version: 1,
  loop: false,
  keyframes: [key(0, at(0)), { ...key(2, at(1)), ...keyframe }],
  ...change,
});

test("passes its keyframes on time, and the reel's time is linear between them", () => {
  const path = new CameraPath([key(0, at(0), 5), key(1, at(2), 6), key(4, at(3), 0)], false);
  for (const { at: seconds, time, viewmat } of path.keyframes) {
    assert.deepEqual(
      path.at(seconds).viewmat.map((v) => Math.round(v * 1e9) / 1e9 + 0),
      viewmat.map((v) => v + 0),
    );
    assert.ok(Math.abs(path.at(seconds).time - time) < 1e-9);
  }
  assert.ok(Math.abs(path.at(2.5).time - 3) < 1e-9);
  assert.equal(path.at(99).time, 0);
  assert.equal(path.seconds, 4);
});

test("is smooth at keyframes, and rests between equal keyframes", () => {
  const path = new CameraPath([key(0, at(0)), key(1, at(1)), key(3, at(2)), key(4, at(2)), key(5, at(4))], false);
  const speed = (seconds: number): number => (x(path, seconds + 1e-4) - x(path, seconds - 1e-4)) / 2e-4;
  assert.ok(Math.abs(speed(1 - 1e-3) - speed(1 + 1e-3)) < 0.02);
  for (const seconds of [3, 3.3, 3.7, 4]) assert.ok(Math.abs(x(path, seconds) - 2) < 1e-9, String(seconds));
});

test("a closed loop is smooth at its seam, and repeats", () => {
  const ring = [at(0), at(1), at(1, 1), at(0, 1), at(0)].map((viewmat, i) => key(i, viewmat));
  const way = (path: CameraPath, seconds: number): number[] =>
    subtract(eyeOf(path.at(seconds + 1e-4).viewmat), eyeOf(path.at(seconds).viewmat));
  const [open, closed] = [false, true].map((loop) => new CameraPath(ring, loop));
  const kink = (path: CameraPath): number =>
    length(subtract(way(path, 0) as [number, number, number], way(path, 3.9998) as [number, number, number]));
  assert.ok(kink(closed) < 1e-6 && kink(open) > 1e-4);
  assert.deepEqual(closed.at(4.5), closed.at(0.5));
});

test("the path through the cameras visits the nearest unvisited one, there and back, without a stop", () => {
  assert.deepEqual(
    nearestFirst(at(0), [at(3), at(0), at(1), at(2)]).map((m) => eyeOf(m)[0] + 0),
    [0, 1, 2, 3],
  );
  const path = CameraPath.through(at(0), [at(3), at(0), at(1), at(2)]);
  assert.deepEqual(
    path.keyframes.map(({ viewmat }) => eyeOf(viewmat)[0] + 0),
    [0, 1, 2, 3, 2, 1, 0],
  );
  assert.ok(path.loop);
  for (let t = 0; t < 24; t += 0.05) assert.ok(Math.abs(x(path, t + 0.05) - x(path, t)) < 0.1, `it jumps at ${t} s`);
  assert.equal(eyeOf(path.at(3.9, true).viewmat)[0], 1);
  const single = CameraPath.through(at(0), [at(0)]);
  assert.ok(x(single, 3) === 0);
});

test("an invalid path is rejected with the place and the remedy", () => {
  const cases: [unknown, RegExp][] = [
    [[], /a\.json is not a camera path: its format is absent/],
    [file({ version: 2 }), /version is 2.*Update/],
    [file({ keyframes: [] }), /not a list of 1 to 10000/],
    [file({}, { at: 0 }), /at of keyframe 1 is 0.*grow/],
    [file({}, { at: "2" }), /at of keyframe 1 is "2"/],
    [file({}, { time: -1 }), /time of keyframe 1 is -1/],
    [file({}, { viewmat: [1, 2] }), /viewmat of keyframe 1 is \[1,2\].*16 numbers/],
    [file({}, { viewmat: IDENTITY.map((v) => 2 * v) }), /viewmat of keyframe 1/],
    [file({}, { viewmat: IDENTITY.map((v, i) => (i === 0 ? -1 : v)) }), /viewmat of keyframe 1/],
    [file({ keyframes: [null] }), /at of keyframe 0 is absent/],
  ];
  for (const [value, message] of cases) assert.throws(() => parsePath(value, "a.json"), { name: "ReelError", message });
  assert.deepEqual(JSON.parse(JSON.stringify(parsePath(file(), "a.json"))), JSON.parse(JSON.stringify(file())));
});

test("has the same poses as in Python", () => {
  const golden = JSON.parse(readFileSync(join(process.cwd(), "../tests/data/golden-paths.json"), "utf8")) as {
    path: PathFile;
    moments: { seconds: number; time: number; viewmat: number[] }[];
  }[];
  for (const { path: document, moments } of golden) {
    const path = parsePath(document, "golden");
    for (const { seconds, time, viewmat } of moments) {
      const moment = path.at(seconds);
      assert.ok(Math.abs(moment.time - time) < 1e-9);
      moment.viewmat.forEach((value, i) =>
        assert.ok(Math.abs(value - viewmat[i]) < 1e-6, `${seconds}: ${moment.viewmat} is not ${viewmat}`),
      );
    }
  }
});

const keys = (...at: number[]): Keyframe[] => at.map((seconds) => ({ at: seconds, time: 0, viewmat: [seconds] }));
const seconds = (keyframes: Keyframe[]): number[] => keyframes.map(({ at }) => at);

test("a new keyframe is as much later as the reel's time, or by a fixed step", () => {
  let all = appended([], 3, [0]);
  all = appended(all, 4.5, [1]);
  all = appended(all, 4.5, [2]);
  all = appended(all, 1, [3]);
  assert.deepEqual(seconds(all), [0, 1.5, 3.5, 5.5]);
  assert.deepEqual(
    all.map(({ time }) => time),
    [3, 4.5, 4.5, 1],
  );
});

test("after removal of the first keyframe the path begins at 0 again", () => {
  assert.deepEqual(seconds(without(keys(0, 2, 5), 0)), [0, 3]);
  assert.deepEqual(seconds(without(keys(0, 2, 5), 1)), [0, 5]);
  assert.deepEqual(without(keys(0), 0), []);
});

test("moving a keyframe moves the later ones too, and keeps the order", () => {
  assert.deepEqual(seconds(moved(keys(0, 2, 5), 1, 3)), [0, 3, 6]);
  assert.deepEqual(seconds(moved(keys(0, 2, 5), 2, 0)), [0, 2, 2.1]);
});

test("the whole path lasts as long as requested, at least a tenth of a second per leg", () => {
  assert.deepEqual(seconds(lasting(keys(0, 2, 5), 10)), [0, 4, 10]);
  assert.ok(seconds(lasting(keys(0, 2, 5), 0)).every((at, i, all) => i === 0 || at > all[i - 1]));
  assert.deepEqual(lasting(keys(0), 10), keys(0));
});

test("a path through views follows the reel's pace where that is slow enough", () => {
  assert.deepEqual(
    throughViews([[0], [1], [2]], 0, 10).map(({ at, time }) => [at, time]),
    [
      [0, 0],
      [5, 5],
      [10, 10],
    ],
  );
  assert.deepEqual(
    throughViews([[0], [1], [2]], 0, 1).map(({ at, time }) => [at, time]),
    [
      [0, 0],
      [2, 0.5],
      [4, 1],
    ],
  );
  assert.deepEqual(seconds(throughViews([[0]], 0, 1)), [0]);
  assert.deepEqual(
    throughViews([[0], [1], [2]], 20, 30).map(({ at, time }) => [at, time]),
    [
      [0, 20],
      [5, 25],
      [10, 30],
    ],
    "the beginning was dropped",
  );
});
