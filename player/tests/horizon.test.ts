import assert from "node:assert/strict";
import { test } from "node:test";
import "./fakes/page";
import {
  cross,
  dot,
  eyeOf,
  length,
  normalize,
  rotate,
  subtract,
  viewmatOf,
  type Vec3,
} from "../packages/decoder/src/base/matrix";
import { OrbitCamera } from "../packages/element/src/camera/orbit-camera";
import type { Player } from "../packages/element/src/player/player";
import type { Manifest } from "../packages/decoder/src/reel/manifest";
import type { CooperativeGestures } from "../packages/element/src/ui/cooperative-gestures";
import { attachKeys, type Actions } from "../packages/element/src/ui/keys";
import { attachPointerControls } from "../packages/element/src/ui/pointer-controls";
import { manifestOf } from "./fakes/scene";

class Key extends EventTarget {
  readonly isContentEditable = false;
  matches = (): boolean => false;
}
Object.assign(globalThis, { HTMLElement: Key, WheelEvent: { DOM_DELTA_LINE: 1 } });

const UP: Vec3 = [0, -1, 0];
const [WIDTH, HEIGHT] = [480, 320];
const DEGREE = Math.PI / 180;

/** A camera at a place that looks at the origin, rolled by some degrees about its own axis. */
function cameraAt(degrees: number, height: number, roll = 0, up = UP): object {
  const side = normalize(cross(up, [0, 0, 1]));
  const eye = rotate(rotate([0, 0, -4], side, height * DEGREE), up, degrees * DEGREE);
  const forward = normalize(subtract([0, 0, 0], eye));
  const right = rotate(normalize(cross(forward, up)), forward, roll * DEGREE);
  return {
    name: "",
    width: 480,
    height: 320,
    K: [400, 0, 240, 0, 400, 160, 0, 0, 1],
    viewmat: viewmatOf(eye, right, cross(forward, right), forward),
  };
}

const reel = (cameras: Camera[], limits: object | null = null, up = UP): Manifest => manifestOf(limits, cameras, up);

/** Degrees by which the horizon is off level: of the right axis, which lies in it. */
function rollOf({ viewmat: m }: OrbitCamera, up: Vec3): number {
  const forward: Vec3 = [m[8], m[9], m[10]];
  const level = normalize(cross(forward, up));
  return Math.atan2(dot([m[4], m[5], m[6]], level), dot([m[0], m[1], m[2]], level)) / DEGREE;
}

/** Numbers from 0 to 1, the same for the same seed (mulberry32). */
function randomOf(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** A player's picture and keyboard under the hands of a person, by the handlers that browsers call. */
class Hands {
  readonly camera: OrbitCamera;
  private readonly surface = Object.assign(new EventTarget(), {
    clientWidth: WIDTH,
    clientHeight: HEIGHT,
    setPointerCapture: () => undefined,
    getBoundingClientRect: () => ({ left: 0, top: 0 }),
  });
  private readonly keyboard = new Key();
  private readonly life = new AbortController();
  private time = 0;

  constructor(
    manifest: Manifest,
    private readonly random: () => number,
  ) {
    this.camera = new OrbitCamera(manifest);
    const { camera } = this;
    const stage = {
      get view() {
        return camera.view(WIDTH, HEIGHT);
      },
      depthAt: () => 1 + 6 * random(),
    };
    const player = {
      camera,
      stage,
      canvas: this.surface,
      invalidate: () => undefined,
      soundtrack: { toggle: () => undefined },
      step: () => undefined,
      currentTime: 0,
      duration: 1,
      earliest: 0,
      playbackRate: 1,
    } as unknown as Player;
    const gestures = { active: true, takesWheel: () => true } as unknown as CooperativeGestures;
    const actions = { reset: () => camera.reset(), fly: () => camera.fly(!camera.flying) } as unknown as Actions;
    const { signal } = this.life;
    attachPointerControls(this.surface as unknown as HTMLElement, player, gestures, signal);
    attachKeys(this.keyboard as unknown as HTMLElement, player, actions, signal);
  }

  /** Take the hands away. */
  leave(): void {
    this.life.abort();
  }

  /** Let frames of 1/60 second pass. */
  frames(count: number): void {
    for (let i = 0; i < count; i++) this.camera.step(1 / 60);
    this.time += (1000 / 60) * count;
  }

  pointer(type: string, id: number, x: number, y: number, more: object = {}): void {
    this.send(this.surface, type, {
      pointerId: id,
      clientX: x,
      clientY: y,
      button: 0,
      shiftKey: false,
      pointerType: "mouse",
      ...more,
    });
  }

  drag(dx: number, dy: number, moves: number, more: object = {}): void {
    this.pointer("pointerdown", 1, 240, 160, more);
    for (let i = 1; i <= moves; i++) {
      this.frames(1);
      this.pointer("pointermove", 1, 240 + (dx * i) / moves, 160 + (dy * i) / moves, more);
    }
  }

  /** One gesture of any kind. */
  gesture(): void {
    const { random } = this;
    const between = (low: number, high: number): number => low + (high - low) * random();
    const kind = Math.floor(between(0, 7));
    if (kind === 0) {
      this.drag(between(-450, 450), between(-450, 450), 12);
      this.frames(6); // a rest before letting go: no flick
      this.pointer("pointerup", 1, 240, 160);
    } else if (kind === 1) {
      this.drag(between(-450, 450), between(-450, 450), 3);
      this.pointer("pointerup", 1, 240, 160);
    } else if (kind === 2) {
      const [x, y] = [between(0, WIDTH), between(0, HEIGHT)];
      const by = { pointerType: random() < 0.5 ? "mouse" : "touch" };
      for (let i = 0; i < 2; i++) {
        this.pointer("pointerdown", 1, x, y, by);
        this.pointer("pointerup", 1, x, y, by);
        this.frames(4);
      }
    } else if (kind === 3) {
      for (let i = 0; i < 4; i++) this.send(this.surface, "wheel", { deltaY: between(-200, 200), deltaMode: 0 });
    } else if (kind === 4) {
      const keys = "w a s d q e + - [ ] c r ArrowUp ArrowDown ArrowLeft ArrowRight".split(" ");
      const key = keys[Math.floor(random() * keys.length)];
      this.send(this.keyboard, "keydown", { key, code: key, shiftKey: true });
      this.frames(Math.floor(between(1, 30)));
      this.send(this.keyboard, "keyup", { key, code: key });
    } else if (kind === 5) {
      const [angle, from, to] = [between(0, 6.28), between(20, 150), between(20, 150)];
      const at = (size: number, side: number, turn: number): [number, number] => [
        240 + side * size * Math.cos(angle + turn),
        160 + side * size * Math.sin(angle + turn),
      ];
      for (const side of [-1, 1]) this.pointer("pointerdown", 2 + side, ...at(from, side, 0), { pointerType: "touch" });
      for (let i = 1; i <= 6; i++)
        for (const side of [-1, 1])
          this.pointer("pointermove", 2 + side, ...at(from + ((to - from) * i) / 6, side, 0.1 * i), {
            pointerType: "touch",
          });
      for (const side of [-1, 1]) this.pointer("pointerup", 2 + side, 240, 160, { pointerType: "touch" });
    } else {
      this.drag(between(-300, 300), between(-300, 300), 6, { shiftKey: true });
      this.pointer("pointerup", 1, 240, 160);
    }
    this.frames(Math.floor(between(0, 40)));
  }

  private send(target: EventTarget, type: string, fields: object): void {
    const event = new Event(type, { cancelable: true });
    for (const [name, value] of Object.entries({ timeStamp: this.time, ...fields }))
      Object.defineProperty(event, name, { value });
    target.dispatchEvent(event);
  }
}

const ring = (roll = 0, up = UP): object[] =>
  [-40, -15, 0, 20, 45].map((angle, i) => cameraAt(angle, 10 + 8 * i, roll * (i % 2 ? -1 : 1), up));
const LEANING = normalize([0.2, -1, 0.3]);
const REELS: [string, Manifest, Vec3][] = [
  ["level cameras", reel(ring()), UP],
  ["cameras rolled by 2 degrees", reel(ring(2)), UP],
  ["narrow limits", reel(ring(2), { focus: [0, 0, 0], angle: 15, distance: [1, 8], floor: -0.5 }), UP],
  [
    "a limit across the zenith",
    reel([cameraAt(0, 70), cameraAt(10, 75)], { focus: [0, 0, 0], angle: 10, distance: [2, 6], floor: -2 }),
    UP,
  ],
  ["an up that leans", reel(ring(2, LEANING), null, LEANING), LEANING],
];

for (const [name, manifest, up] of REELS) {
  test(`after 200 random gestures the horizon is level: ${name}`, () => {
    for (let seed = 1; seed <= 6; seed++) {
      const hands = new Hands(manifest, randomOf(seed));
      for (let i = 0; i < 200; i++) hands.gesture();
      const roll = rollOf(hands.camera, up);
      assert.ok(Math.abs(roll) < 0.5, `seed ${seed}: rolled by ${roll} degrees`);
      assert.ok(hands.camera.viewmat.every(Number.isFinite));
      hands.leave();
    }
  });
}

test("five vertical drags, and as many flicks, leave the horizon level", () => {
  const manifest = reel([cameraAt(0, 5, 0.01), cameraAt(30, 10)], {
    focus: [0, 0, 0],
    angle: 20,
    distance: [1, 8],
    floor: -0.5,
  });
  for (const rest of [6, 0]) {
    for (const way of [-450, 450]) {
      const hands = new Hands(manifest, randomOf(1));
      for (let i = 0; i < 5; i++) {
        hands.drag(3, way, 12);
        hands.frames(rest);
        hands.pointer("pointerup", 1, 240, 160);
        hands.frames(120);
        const roll = rollOf(hands.camera, UP);
        assert.ok(Math.abs(roll) < 0.01, `${roll} degrees after ${i + 1} drags of ${way} pixels`);
      }
      hands.leave();
    }
  }
});

test("a double click turns by yaw and pitch, and stays level all the way", () => {
  const hands = new Hands(reel([cameraAt(0, 30)]), randomOf(1));
  hands.camera.focus([1.5, 1, 4]);
  for (let i = 0; i < 60; i++) {
    hands.frames(1);
    assert.ok(Math.abs(rollOf(hands.camera, UP)) < 1e-6);
  }
});

test("a rolled camera is shown as it is, and dragging levels it gradually", () => {
  const camera = new OrbitCamera(reel([cameraAt(0, 10, 2)]));
  assert.ok(Math.abs(Math.abs(rollOf(camera, UP)) - 2) < 1e-6);
  camera.step(1);
  assert.ok(Math.abs(Math.abs(rollOf(camera, UP)) - 2) < 1e-6, "nobody has touched it");
  camera.hold();
  camera.orbit(0.01, 0);
  camera.step(1 / 60);
  assert.ok(Math.abs(rollOf(camera, UP)) > 1.7);
  while (camera.step(1 / 60));
  assert.ok(Math.abs(rollOf(camera, UP)) < 1e-3);
});

test("a camera that looks straight down is shown as it is, and dragging does not spin it", () => {
  for (const turn of [0, 100, 200, 300]) {
    const right = rotate([1, 0, 0], UP, turn * DEGREE);
    const forward = normalize([0.01, 1, 0.02]);
    const x = normalize(subtract(right, forward.map((part) => part * dot(right, forward)) as Vec3));
    const viewmat = viewmatOf([0, -4, 0], x, cross(forward, x), forward);
    const camera = new OrbitCamera(reel([{ ...cameraAt(0, 0), viewmat }]));
    camera.viewmat.forEach((value, i) => assert.ok(Math.abs(value - viewmat[i]) < 1e-9));
    camera.orbit(0.001, 0);
    while (camera.step(1 / 60));
    const m = camera.viewmat;
    assert.ok(Math.abs(rollOf(camera, UP)) < 1e-3);
    assert.ok(dot([m[0], m[1], m[2]], x) > 0.98, "what was to the right still is");
    assert.ok(length(subtract(eyeOf(m), [0, -4, 0])) < 0.1);
  }
});
