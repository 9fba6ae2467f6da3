import assert from "node:assert/strict";
import { test } from "node:test";
import { eyeOf, type Vec3 } from "../packages/decoder/src/base/matrix";
import { HeadsetSpace } from "../packages/element/src/camera/headset-space";
import { Limits } from "../packages/element/src/camera/limits";
import { HeadsetGrip, HeadsetPlacement, HeadsetTeleport, meetsLevel } from "../packages/element/src/player/headset";
import type { XrFrame, XrInput, XrSession } from "../packages/element/src/player/headset-support";
import { CAMERA, close, MANIFEST } from "./fakes/scene";
import type { Camera, Manifest } from "../packages/decoder/src/reel/manifest";

const HEAD: Vec3 = [0, 1.6, 0];
const SPACE = {};

/** Column-major pose at a point that looks along a direction (only its z axis matters). */
const poseAt = (at: Vec3, direction: Vec3 = [0, 0, -1]): Float64Array =>
  new Float64Array([1, 0, 0, 0, 0, 1, 0, 0, -direction[0], -direction[1], -direction[2], 0, ...at, 1]);

class Hand implements XrInput {
  readonly targetRaySpace = {};
  readonly gripSpace = {};
  gamepad = { axes: [0, 0, 0, 0] };
  constructor(
    public at: Vec3,
    public direction: Vec3 = [0, 0, -1],
    readonly targetRayMode = "tracked-pointer",
  ) {}
}

function frameOf(...hands: Hand[]): XrFrame {
  const getPose = (space: object): unknown => {
    const hand = hands.find(({ targetRaySpace, gripSpace }) => space === targetRaySpace || space === gripSpace);
    return hand ? { transform: { matrix: poseAt(hand.at, hand.direction) } } : null;
  };
  return { getPose } as unknown as XrFrame;
}

const send = (session: EventTarget, name: string, inputSource: Hand): void =>
  void session.dispatchEvent(Object.assign(new Event(name), { inputSource }));
const roomOf = (floor = true): HeadsetSpace => new HeadsetSpace(MANIFEST, CAMERA.viewmat, floor);

function grip(room = roomOf()): {
  session: EventTarget;
  grip: HeadsetGrip;
  selected: () => number;
  room: HeadsetSpace;
} {
  const session = new EventTarget();
  let count = 0;
  return {
    session,
    room,
    grip: new HeadsetGrip(session as XrSession, room, () => void count++),
    selected: () => count,
  };
}

test("a short pinch selects, and a pinch that moves takes the reel along", () => {
  const { session, grip: hands, selected, room } = grip();
  const middle = room.worldOf([0, 1.6, -2]);
  const hand = new Hand([0, 1, -0.5]);
  send(session, "selectstart", hand);
  hands.update(frameOf(hand), SPACE);
  hand.at = [0.01, 1, -0.5]; // a tremble
  hands.update(frameOf(hand), SPACE);
  send(session, "select", hand);
  send(session, "selectend", hand);
  assert.equal(selected(), 1);
  close(room.pointOf(middle), [0, 1.6, -2]);
  send(session, "selectstart", hand);
  for (const x of [0, 0.1, 0.3, 0.6]) {
    hand.at = [x, 1, -0.5];
    hands.update(frameOf(hand), SPACE);
  }
  send(session, "select", hand);
  send(session, "selectend", hand);
  assert.equal(selected(), 1, "a grab does not select");
  close(room.pointOf(middle), [0.5, 1.6, -2]); // without the way within the dead zone
});

test("a squeeze moves the reel at once, until it ends", () => {
  const { session, grip: hands, room } = grip();
  const middle = room.worldOf([0, 1.6, -2]);
  const hand = new Hand([0, 1, 0]);
  send(session, "squeezestart", hand);
  hands.update(frameOf(hand), SPACE);
  hand.at = [0, 1.01, 0.5];
  hands.update(frameOf(hand), SPACE);
  send(session, "squeezeend", hand);
  hand.at = [3, 3, 3];
  hands.update(frameOf(hand), SPACE);
  close(room.pointOf(middle), [0, 1.61, -1.5]);
});

test("two hands scale and turn the reel between them", () => {
  const { session, grip: hands, room } = grip();
  const middle = room.worldOf([0, 1, -1]);
  const [left, right] = [new Hand([-0.2, 1, -1]), new Hand([0.2, 1, -1])];
  for (const hand of [left, right]) send(session, "squeezestart", hand);
  hands.update(frameOf(left, right), SPACE);
  [left.at, right.at] = [
    [0, 1, -0.6],
    [0, 1, -1.4],
  ]; // a quarter turn, counterclockwise, and twice as far apart
  const before = room.worldOf([0.2, 1, -1]);
  hands.update(frameOf(left, right), SPACE);
  close(room.pointOf(middle), [0, 1, -1]);
  close(room.pointOf(before), [0, 1, -1.4]); // it stays in the right hand
  assert.ok(Math.abs(room.meters - 1) < 1e-9);
});

test("a finger on the screen drags the reel along the floor", () => {
  const { session, grip: hands, room } = grip();
  const foot = room.worldOf([0, 0, -2]);
  const finger = new Hand(HEAD, [0, -0.8, -0.6], "screen");
  send(session, "selectstart", finger);
  for (const z of [-0.6, -0.7, -1.2]) {
    finger.direction = [0, -0.8, z];
    hands.update(frameOf(finger), SPACE);
  }
  close(room.pointOf(foot), [0, 0, -3]); // the floor is hit 1.4 m ahead, then 2.4 m
});

test("a ray meets the floor only ahead and within reach", () => {
  close(meetsLevel({ origin: [0, 1, 0], direction: [0, -0.6, -0.8] }, 0, 10)!, [0, 0, -4 / 3]);
  assert.equal(meetsLevel({ origin: [0, 1, 0], direction: [0, 0.6, -0.8] }, 0, 10), null);
  assert.equal(meetsLevel({ origin: [0, 1, 0], direction: [0, -0.01, -1] }, 0, 10), null);
});

test("the stick aims ahead, and the viewer stands there on release", () => {
  const room = roomOf();
  const teleport = new HeadsetTeleport(room, new Limits(MANIFEST));
  const hand = new Hand([0, 1, 0], [0, -0.5, -0.5]);
  const target = room.worldOf([0, 0, -1]);
  hand.gamepad.axes = [0, 0, 0, -1];
  assert.deepEqual(teleport.update(frameOf(hand), SPACE, [hand], HEAD), [
    { from: [0, 1, 0], to: [0, 0, -1] },
    { center: [0, 0, -1] },
  ]);
  hand.gamepad.axes = [0, 0, 0, 0];
  assert.deepEqual(teleport.update(frameOf(hand), SPACE, [hand], HEAD), []);
  close(room.pointOf(target), [0, 0, 0]);
});

test("there is no jump beyond the limits of the view", () => {
  const room = roomOf();
  const limits = { focus: [0, 0, 0], distance: [0, 4.5], angle: 180 };
  const teleport = new HeadsetTeleport(
    room,
    new Limits({ ...MANIFEST, presentation: { limits } } as unknown as Manifest),
  );
  const hand = new Hand([0, 1, 0], [0, -0.5, 0.5]); // a meter back, at six units
  const before = room.worldOf([0, 0, 0]);
  hand.gamepad.axes = [0, 0, 0, -1];
  assert.equal(teleport.update(frameOf(hand), SPACE, [hand], HEAD).length, 1, "a ray without a ring");
  hand.gamepad.axes = [0, 0, 0, 0];
  teleport.update(frameOf(hand), SPACE, [hand], HEAD);
  close(room.worldOf([0, 0, 0]), before);
});

test("the stick turns the viewer by steps of 30 degrees", () => {
  const room = roomOf();
  const teleport = new HeadsetTeleport(room, new Limits(MANIFEST));
  const hand = new Hand([0, 1, 0]);
  const ahead = room.worldOf([0, 1.6, -2]);
  for (const x of [1, 1, 0, 0.9, 0]) {
    hand.gamepad.axes = [0, 0, x, 0];
    teleport.update(frameOf(hand), SPACE, [hand], HEAD);
  }
  close(room.pointOf(ahead), [-2 * Math.sin(Math.PI / 3), 1.6, -2 * Math.cos(Math.PI / 3)]); // to the left of who turned right
});

async function placement(
  hits: { matrix: number[] }[],
  room: HeadsetSpace,
): Promise<{ placed: HeadsetPlacement; frame: XrFrame }> {
  const session = {
    requestReferenceSpace: async () => ({}),
    requestHitTestSource: async () => ({}),
  } as unknown as XrSession;
  const frame = {
    getHitTestResults: () => hits.map((transform) => ({ getPose: () => ({ transform }) })),
  } as unknown as XrFrame;
  return { placed: await HeadsetPlacement.begin(session, room, MANIFEST, [0, 0, -4]), frame };
}

test("a reel stands where the viewer looks, with its first view toward the viewer", async () => {
  const room = roomOf();
  const wall = [0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 1, 5, 1];
  const floor = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0.1, 0, 1];
  const { placed, frame } = await placement([{ matrix: wall }, { matrix: floor }], room);
  assert.deepEqual(placed.update(frame, SPACE), [{ center: [3, 0.1, 0] }]);
  placed.place(poseAt(HEAD, [1, 0, 0]));
  close(room.pointOf([0, 1, 0]), [3, 0.1, 0]); // the foot of the bounds
  close(room.pointOf([0, 0, -4]), [1, 0.6, 0]); // the first camera, two meters nearer to the viewer
  assert.equal(placed.placed, true);
  assert.deepEqual(placed.update(frame, SPACE), []);
});

test("without a floor the reel is placed two meters ahead", async () => {
  const room = roomOf();
  const { placed, frame } = await placement([], room);
  assert.deepEqual(placed.update(frame, SPACE), []);
  placed.place(poseAt(HEAD, [0, -0.6, -0.8]));
  close(room.pointOf([0, 1, 0]), [0, 0, -2]);
});

const VIEWMAT = CAMERA.viewmat;
/** Column by column: an eye at (x, y, z) that looks along -z; a square picture of 90 degrees. */
const eyeAt = (x: number, y: number, z: number): number[] => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, -z, 1];
const PROJECTION = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, -1, 0, 0, -0.2, 0];

test("the viewer stands at the view, with the eyes 1.6 m above the floor", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  assert.equal(room.meters, 0.5); // the cameras' four units are two meters
  const view = room.view(eyeAt(0, 1.6, 0), PROJECTION, 200, 100, 0.01);
  close(view.viewmat, VIEWMAT);
  close([view.fx, view.fy, view.cx, view.cy], [100, 50, 100, 50]);
});

test("a step in the room is a step in the scene, in meters", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  // A meter to the right, half a meter up and a meter ahead of where people began.
  close(eyeOf(room.view(eyeAt(1, 2.1, -1), PROJECTION, 200, 100, 0.01).viewmat), [2, -1, -2]);
});

test("without a floor the eyes are at the view", () => {
  close(new HeadsetSpace(MANIFEST, VIEWMAT, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01).viewmat, VIEWMAT);
});

test("a viewer who looked down stands upright", () => {
  const down = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 4, 0, 0, 0, 1]; // forward is +y, the top of the picture +z
  const { viewmat } = new HeadsetSpace(MANIFEST, down, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01);
  close(viewmat.slice(8, 11), [0, 0, 1]);
  close(viewmat.slice(4, 7), [0, 1, 0]);
});

test("the room follows the reel's up direction, however the camera was rolled", () => {
  const leaning = { ...MANIFEST, up: [0.6, -0.8, 0] } as Manifest;
  const { viewmat } = new HeadsetSpace(leaning, VIEWMAT, false).view(eyeAt(0, 0, 0), PROJECTION, 10, 10, 0.01);
  close(viewmat.slice(4, 7), [-0.6, 0.8, 0]); // the picture's down
  close(viewmat.slice(8, 11), [0, 0, 1]);
});

test("eyes with asymmetric frusta have principal points off the image center", () => {
  const skewed = [...PROJECTION];
  [skewed[8], skewed[9]] = [0.1, -0.2];
  const { cx, cy } = new HeadsetSpace(MANIFEST, VIEWMAT, true).view(eyeAt(0, 1.6, 0), skewed, 200, 100, 0.01);
  close([cx, cy], [90, 40]);
});

test("points go to the world and back", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  close(room.worldOf([0, 1.6, 0]), [0, 0, -4]);
  close(room.worldOf([1, 0.6, -2]), [2, 2, 0]);
  close(room.pointOf([2, 2, 0]), [1, 0.6, -2]);
});

test("the reel turns and scales about a point, which moves to another", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  const [held, ahead] = [
    [0, 1.6, -2],
    [0.5, 1, -1],
  ] as [number, number, number][];
  const middle = room.worldOf(held);
  const right = room.worldOf([1, 1.6, -2]); // a meter beside it
  room.transform(2, Math.PI / 2, held, ahead);
  assert.equal(room.meters, 1);
  close(room.pointOf(middle), ahead);
  close(room.pointOf(right), [0.5, 1, -3]); // counterclockwise, as seen from above, and two meters away
  close(room.worldOf(room.pointOf(right)), right);
});

test("a reel grows and shrinks by a factor of 50 at most", () => {
  const room = new HeadsetSpace(MANIFEST, VIEWMAT, true);
  room.transform(1e6, 0, [0, 0, 0], [0, 0, 0]);
  assert.equal(room.meters, 25);
  room.transform(1e-9, 0, [0, 0, 0], [0, 0, 0]);
  assert.equal(room.meters, 0.01);
});
