/** Properties and methods of HTMLMediaElement for the objects of other engines, which share no base class. */
import type { ReelPlayer } from "./reel-player";

// eslint-disable-next-line @typescript-eslint/no-explicit-any -- TypeScript requires it of mixins
type Values = any[];
type Class = abstract new (...values: Values) => object;

/** Properties and methods of a media element, which `player` has. */
export abstract class MediaProperties {
  /** Time, sound and files of the reel. It may change between versions. */
  abstract readonly player: ReelPlayer;

  /** Start to play. Browsers require an interaction before sound; until then the reel is muted, and `muted` is true. */
  play(): void {
    this.player.play();
  }

  pause(): void {
    this.player.pause();
  }

  get paused(): boolean {
    return this.player.paused;
  }

  get currentTime(): number {
    return this.player.currentTime;
  }

  set currentTime(seconds: number) {
    this.player.currentTime = seconds;
  }

  /** End of the reel, in seconds; 0 before its manifest arrives. */
  get duration(): number {
    return this.player.clock.duration;
  }

  get loop(): boolean {
    return this.player.loop;
  }

  set loop(loop: boolean) {
    this.player.loop = loop;
  }

  get playbackRate(): number {
    return this.player.clock.rate;
  }

  set playbackRate(rate: number) {
    this.player.clock.rate = rate;
  }

  get muted(): boolean {
    return this.player.soundtrack.muted;
  }

  set muted(muted: boolean) {
    this.player.soundtrack.muted = muted;
  }

  /** 0 to 1. */
  get volume(): number {
    return this.player.soundtrack.volume;
  }

  set volume(volume: number) {
    this.player.soundtrack.volume = volume;
  }

  /** True if the direction and distance of the sound follow the camera, for reels whose sound has a position. */
  get positional(): boolean {
    return this.player.soundtrack.spatial.on;
  }

  set positional(on: boolean) {
    this.player.soundtrack.spatial.on = on;
  }

  get ended(): boolean {
    return this.player.ended;
  }

  get seeking(): boolean {
    return this.player.seeking;
  }

  /** True while playback waits for data or sound. */
  get waiting(): boolean {
    return this.player.waiting;
  }

  /** True once a complete frame has been drawn. */
  get canPlay(): boolean {
    return this.player.canPlay;
  }

  get error(): Error | null {
    return this.player.error;
  }

  /** Names of the renditions, best first. */
  get renditions(): string[] {
    return this.player.renditions;
  }

  /** The chosen rendition; null to adapt to network and device. */
  get rendition(): string | null {
    return this.player.rendition;
  }

  set rendition(name: string | null) {
    this.player.rendition = name;
  }

  /** Number of points drawn. */
  get points(): number {
    return this.player.stage?.points ?? 0;
  }

  /** Color behind the points, sRGB, 0 to 1; null before the manifest arrives. The scene's background is drawn instead. */
  get background(): [number, number, number] | null {
    return this.player.manifest?.background ?? null;
  }

  /** Resolve once a complete frame has been drawn; reject on an error. */
  async whenReady(): Promise<this> {
    await this.player.whenReady();
    return this;
  }
}

/** Return a subclass with the properties of a media element. */
export function withMediaProperties<Base extends Class>(
  base: Base,
): Base & (abstract new (...values: Values) => MediaProperties) {
  abstract class MediaObject extends base {}
  Object.defineProperties(MediaObject.prototype, {
    ...Object.getOwnPropertyDescriptors(MediaProperties.prototype),
    constructor: { value: MediaObject },
  });
  return MediaObject as unknown as Base & (abstract new (...values: Values) => MediaProperties);
}
