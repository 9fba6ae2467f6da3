import assert from "node:assert/strict";
import { test } from "node:test";
import { axesOf, normalized, quatOf, slerp, type Quat } from "../packages/element/src/base/quaternion";
import { linkTo, startOf } from "../packages/element/src/camera/link";
import { close } from "./fakes/scene";

const turns: Quat[] = [
  [1, 0, 0, 0],
  [0, 1, 0, 0],
  [0, 0, 1, 0],
  [0, 0, 0, 1],
  normalized([0.3, -0.5, 0.7, 0.2]),
  normalized([-0.1, 0.9, 0.2, -0.6]),
];

test("a rotation is recovered from its axis and angle", () => {
  for (const turn of turns)
    for (const [i, axis] of axesOf(turn).entries()) close(axis, axesOf(quatOf(axesOf(turn)))[i], 1e-4);
});

test("interpolation of two rotations takes the shorter way", () => {
  const c = Math.SQRT1_2;
  close(slerp([1, 0, 0, 0], [c, 0, 0, c], 0.5), [Math.cos(Math.PI / 8), 0, 0, Math.sin(Math.PI / 8)], 1e-4);
  close(slerp([1, 0, 0, 0], [-c, 0, 0, -c], 0.5), [Math.cos(Math.PI / 8), 0, 0, Math.sin(Math.PI / 8)], 1e-4);
});

test("a link contains a time and a pose", () => {
  const start = { seconds: 1.25, view: { eye: [1, -2.5, 3] as [number, number, number], turn: turns[4], distance: 4 } };
  const read = startOf(linkTo("https://host/page?src=a#old", start));
  assert.equal(read.seconds, 1.25);
  close([...read.view!.eye, ...read.view!.turn, read.view!.distance], [1, -2.5, 3, ...turns[4], 4], 1e-4);
});

test("missing or invalid parts of a link change nothing", () => {
  for (const end of ["", "#", "#t=x&view=1,2,3", "#view=0,0,0,0,0,0,0,1", "#view=1,2,3,1,0,0,0,nan"]) {
    assert.deepEqual(startOf(`https://host/${end}`), { seconds: null, view: null });
  }
});
