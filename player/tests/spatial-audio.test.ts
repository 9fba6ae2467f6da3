import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import type { Manifest } from "../packages/decoder/src/reel/manifest";
import { SpatialSound } from "../packages/renderer/src/sound/spatial-sound";
import { device } from "./fakes/page";
import { manifestOf } from "./fakes/reel";
import { settled } from "./fakes/time";

/** A node that knows what it is connected to. */
class Node {
  to: Node[] = [];
  readonly options: { gain?: number };
  readonly positionX = new Parameter();
  readonly positionY = new Parameter();
  readonly positionZ = new Parameter();
  constructor(_: unknown, options: { gain?: number } = {}) {
    this.options = options;
  }
  connect(node: Node): Node {
    this.to.push(node);
    return node;
  }
  disconnect(): void {
    this.to = [];
  }
}

class Parameter {
  value = NaN;
  setTargetAtTime(value: number): void {
    this.value = value;
  }
}

class Context {
  static last: Context;
  state = "suspended";
  allowed = true;
  currentTime = 0;
  baseLatency = 0.01;
  outputLatency = 0.02;
  readonly destination = new Node(this);
  readonly source = new Node(this);
  constructor() {
    Context.last = this;
  }
  resume(): Promise<void> {
    this.state = this.allowed ? "running" : "suspended";
    return Promise.resolve();
  }
  createMediaElementSource(): Node {
    return this.source;
  }
  close(): Promise<void> {
    this.state = "closed";
    return Promise.resolve();
  }
}
Object.assign(globalThis, { AudioContext: Context, PannerNode: Node, GainNode: Node });

const audio = {} as HTMLAudioElement;
const at = (x: number): number[] => [1, 0, 0, -x, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1];
const plain = manifestOf();
const placed: Manifest = {
  ...plain,
  presentation: {
    ...plain.presentation,
    sound: { position: [0, 0, 0] } as unknown as Manifest["presentation"]["sound"],
  },
};
let sound: SpatialSound;

beforeEach(() => {
  device.userActivation.hasBeenActive = true;
  sound = new SpatialSound();
});

test("before user input the media element plays directly", async () => {
  device.userActivation.hasBeenActive = false;
  const before = Context.last;
  sound.enter(audio, 2);
  await settled();
  assert.deepEqual([Context.last === before, sound.latency], [true, 0]);
  sound.listen(at(0), placed);
});

test("then the sound comes from its position, delayed by the device's latency, and moves with the viewer", async () => {
  sound.enter(audio, 2);
  await settled();
  const context = Context.last;
  const [panner] = context.source.to;
  assert.ok(Math.abs(sound.latency - 0.03) < 1e-9);
  assert.notEqual(panner, context.destination);
  assert.deepEqual([panner.to[0].options.gain, panner.to[0].to], [1, [context.destination]]);
  sound.listen(at(0), placed);
  assert.ok(Math.abs(panner.positionX.value) < 1e-9 && panner.positionZ.value < 0, "before the viewer");
  sound.listen(at(-4), placed);
  assert.ok(panner.positionX.value > 0.5, "the viewer went to the left of it");
  sound.listen(at(0), plain);
  assert.ok(panner.positionX.value > 0.5, "a reel whose sound has no place moves nothing");
});

test("mono sound keeps its loudness on two ears", async () => {
  sound.enter(audio, 1);
  await settled();
  assert.equal(Context.last.source.to[0].to[0].options.gain, Math.SQRT2);
});

test("spatial sound can be turned off and on", async () => {
  sound.on = false;
  sound.enter(audio, 2);
  await settled();
  const { source, destination } = Context.last;
  assert.deepEqual([sound.on, source.to], [false, [destination]]);
  sound.on = true;
  assert.equal(source.to.length, 1);
  assert.notEqual(source.to[0], destination);
  sound.on = false;
  assert.deepEqual(source.to, [destination]);
});

test("the media element is connected once, and released at the end", async () => {
  sound.enter(audio, 2);
  await settled();
  const context = Context.last;
  sound.enter(audio, 2);
  await settled();
  assert.equal(Context.last, context);
  sound.close();
  assert.deepEqual([context.state, sound.latency], ["closed", 0]);
});
