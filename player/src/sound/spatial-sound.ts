/** Sound from a place in the scene, by Web Audio: louder or fainter, left or right, as the viewer moves and turns. */
import { eyeOf, length, scale, subtract, type Vec3 } from "../base/matrix";
import type { Manifest } from "../reel/manifest";

/** How much fainter sound gets with the distance: 0 not at all, 1 as in the open. Rooms carry it. */
const ROLLOFF = 0.5;
/** Sound is as wide as this share of the start view's distance to the middle of the scene: who stands in it hears it from everywhere. */
const WIDTH = 0.35;
/** Seconds in which it moves. */
const GLIDE = 0.05;

export class SpatialSound {
  private context: AudioContext | null = null;
  private node: MediaElementAudioSourceNode | null = null;
  private panner: PannerNode | null = null;
  private through = false;
  private wanted = true;
  /** Where it was heard last. */
  private place: Vec3 = [0, 0, 0];

  /** Take over an element's sound. Works only where a person has touched the page; until then the element plays by itself. */
  enter(audio: HTMLAudioElement, channels: number): void {
    if (navigator.userActivation?.hasBeenActive === false || this.context?.state === "running") return;
    const context = (this.context ??= new AudioContext());
    void context.resume().then(() => (this.node ? undefined : this.build(context, audio, channels)));
  }

  /** Whether sound comes from its place, or just as it was recorded. */
  get on(): boolean {
    return this.wanted;
  }

  set on(on: boolean) {
    this.wanted = on;
    this.connect();
  }

  /** Seconds from where the element's time says to where the ear is, beyond what the element knows. */
  get latency(): number {
    const { context } = this;
    return this.node && context ? context.baseLatency + (context.outputLatency || 0) : 0;
  }

  /** The viewer, as a matrix [16] world to camera, and the reel that is heard. */
  listen(viewmat: number[], manifest: Manifest): void {
    const position = manifest.presentation.sound?.position;
    const { panner, context } = this;
    if (!position || !panner || !context) return;
    const place = placeOf(position, viewmat, manifest);
    if (length(subtract(place, this.place)) < 1e-4) return;
    this.place = place;
    const move = (parameter: AudioParam, value: number): unknown => parameter.setTargetAtTime(value, context.currentTime, GLIDE);
    move(panner.positionX, place[0]);
    move(panner.positionY, -place[1]);
    move(panner.positionZ, -place[2]);
  }

  close(): void {
    void this.context?.close();
    [this.context, this.node, this.panner, this.place] = [null, null, null, [0, 0, 0]];
  }

  private build(context: AudioContext, audio: HTMLAudioElement, channels: number): void {
    if (context.state !== "running") return;
    this.node = context.createMediaElementSource(audio);
    this.panner = new PannerNode(context, { panningModel: "equalpower", distanceModel: "inverse", refDistance: 1, rolloffFactor: ROLLOFF });
    // A panner gives one channel to two ears with the power of one.
    this.panner.connect(new GainNode(context, { gain: channels === 1 ? Math.SQRT2 : 1 })).connect(context.destination);
    this.node.connect(context.destination);
    this.through = false;
    this.connect();
  }

  private connect(): void {
    const { node, panner, context, wanted } = this;
    if (!node || !panner || !context || this.through === wanted) return;
    node.disconnect();
    node.connect(wanted ? panner : context.destination);
    this.through = wanted;
  }
}

/** Where a viewer hears a place, in axes of the camera (x right, y down, z forward), in units of the start view's distance to it. */
export function placeOf(position: Vec3, viewmat: number[], { camera, bounds: [low, high] }: Pick<Manifest, "camera" | "bounds">): Vec3 {
  const middle = scale([low[0] + high[0], low[1] + high[1], low[2] + high[2]], 0.5);
  const width = WIDTH * Math.max(length(subtract(eyeOf(camera.viewmat), middle)), 1e-6);
  return scale(heardFrom(position, viewmat, width), 1 / length(heardFrom(position, camera.viewmat, width)));
}

/** In world units. What is behind sounds as if it were in front, as with two ears; nothing is all in one ear. */
function heardFrom([px, py, pz]: Vec3, m: number[], width: number): Vec3 {
  const row = (i: number): number => m[i] * px + m[i + 1] * py + m[i + 2] * pz + m[i + 3];
  return [row(0), row(4), Math.hypot(row(8), width)];
}
