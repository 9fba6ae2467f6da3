/** Spatial sound by Web Audio: volume and direction follow the position of the viewer. */
import { eyeOf, length, type Manifest, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";

/** Attenuation with distance: 0 for none, 1 as outdoors. Rooms attenuate less. */
const ROLLOFF = 0.5;
/** Radius of the source, relative to the distance between start view and scene center. Inside of it the sound has no direction. */
const WIDTH = 0.35;
/** Time constant of position changes, in seconds. */
const GLIDE = 0.05;

/** Routes an audio element through a panner. */
export class SpatialSound {
  private context: AudioContext | null = null;
  private node: MediaElementAudioSourceNode | null = null;
  private panner: PannerNode | null = null;
  private through = false;
  private wanted = true;
  /** Last position of the source. */
  private place: Vec3 = [0, 0, 0];

  /** Route an element through Web Audio. Without a prior interaction the element keeps playing directly. */
  enter(audio: HTMLAudioElement, channels: number): void {
    if (navigator.userActivation?.hasBeenActive === false || this.context?.state === "running") return;
    const context = (this.context ??= new AudioContext());
    void context.resume().then(() => (this.node ? undefined : this.build(context, audio, channels)));
  }

  /** True if sound is spatial, false if it plays as recorded. */
  get on(): boolean {
    return this.wanted;
  }

  set on(on: boolean) {
    this.wanted = on;
    this.connect();
  }

  /** Output latency in seconds that the element's time does not include. */
  get latency(): number {
    const { context } = this;
    return this.node && context ? context.baseLatency + (context.outputLatency || 0) : 0;
  }

  /** Set the viewer. viewmat [16]: world to camera. */
  listen(viewmat: number[], manifest: Manifest): void {
    const position = manifest.presentation.sound?.position;
    const { panner, context } = this;
    if (!position || !panner || !context) return;
    const place = placeOf(position, viewmat, manifest);
    if (length(subtract(place, this.place)) < 1e-4) return;
    this.place = place;
    const move = (parameter: AudioParam, value: number): unknown =>
      parameter.setTargetAtTime(value, context.currentTime, GLIDE);
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
    this.panner = new PannerNode(context, {
      panningModel: "equalpower",
      distanceModel: "inverse",
      refDistance: 1,
      rolloffFactor: ROLLOFF,
    });
    // The panner splits the power of a mono channel over two ears.
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

/** Return the position of a source in camera axes (x right, y down, z forward), in units of its distance from the start view. */
export function placeOf(
  position: Vec3,
  viewmat: number[],
  { camera, bounds: [low, high] }: Pick<Manifest, "camera" | "bounds">,
): Vec3 {
  const middle = scale([low[0] + high[0], low[1] + high[1], low[2] + high[2]], 0.5);
  const width = WIDTH * Math.max(length(subtract(eyeOf(camera.viewmat), middle)), 1e-6);
  return scale(heardFrom(position, viewmat, width), 1 / length(heardFrom(position, camera.viewmat, width)));
}

/** Return the position in world units. Sources behind the viewer are mirrored to the front, and none is in one ear only. */
function heardFrom([px, py, pz]: Vec3, m: number[], width: number): Vec3 {
  const row = (i: number): number => m[i] * px + m[i + 1] * py + m[i + 2] * pz + m[i + 3];
  return [row(0), row(4), Math.hypot(row(8), width)];
}
