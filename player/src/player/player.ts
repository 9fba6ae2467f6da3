/** Plays a reel on a canvas: what pages and controls ask it for, its states and its events. */
import type { View } from "../base/view";
import { waitUntil } from "../base/wait-until";
import type { OrbitCamera } from "../camera/orbit-camera";
import type { Pose, Start } from "../camera/pose";
import type { Picture, Stage } from "../draw/stage";
import type { LocalFiles } from "../files/local-files";
import type { Manifest } from "../reel/manifest";
import type { Reel } from "../reel/reel";
import { Soundtrack } from "../sound/soundtrack";
import type { Stream } from "../stream/stream";
import { checkedPose, finite } from "./checked-arguments";
import { Clock } from "./clock";
import { Lifecycle } from "./lifecycle";
import { Playback } from "./playback";
import { PlayedRanges } from "./played-ranges";
import type { Prefetched } from "./prefetched";
import { Resolution } from "./resolution";
import type { Session } from "./session";
import { measure, type Stats } from "./stats";

/**
 * Events, named as those of HTMLMediaElement: emptied, loadstart, loadedmetadata, durationchange, loadeddata (something is drawn, if
 * only what rests), canplay (the first whole picture), play, playing (time goes on), pause, timeupdate, progress, waiting, seeking,
 * seeked, ratechange, volumechange, ended, error; deferred (files wait for people, or do not any more), notallowed (no sound before a
 * touch), drawn, pathchange (or it begins or ends).
 */
export class Player extends EventTarget {
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  readonly playback = new Playback(this);
  readonly soundtrack = new Soundtrack((event) => this.emit(event), () => this.pause());

  /** What of the reel was played. */
  readonly played = new PlayedRanges();

  private readonly lifecycle: Lifecycle;
  private choice: string | null = null;
  private isDeferred = false;

  constructor(readonly canvas: HTMLCanvasElement) {
    super();
    this.lifecycle = new Lifecycle({
      canvas,
      clock: this.clock,
      emit: (event) => this.emit(event),
      drawsInSoftware: () => this.resolution.startCoarse(),
      opened: (reel) => this.opened(reel),
      changed: () => this.playback.askForFiles(),
      grown: () => {
        this.soundtrack.refresh();
        if (this.clock.seconds < this.earliest) this.playback.seek(this.earliest); // the present time was dropped
      },
      closed: () => {
        this.soundtrack.close();
        this.playback.reset();
      },
    });
  }

  /** Whether people look: only then pictures are drawn and time goes on. */
  show(on: boolean): void {
    this.playback.run(on);
  }

  /** Get files and hold a graphics device from now on: people may soon look. */
  wake(): void {
    this.lifecycle.wake();
  }

  /** Give back all that takes memory and network. Time and view stay, and `wake` goes on from there. */
  rest(): void {
    if (!this.lifecycle.awake) return;
    this.lifecycle.rest();
    this.soundtrack.release();
    this.emit("progress");
  }

  /** Get no more than the manifest, until people ask for pictures. */
  get deferred(): boolean {
    return this.isDeferred;
  }

  set deferred(deferred: boolean) {
    if (deferred === this.isDeferred) return;
    this.isDeferred = deferred;
    this.playback.askForFiles();
    this.emit("deferred");
  }

  /** Open a reel by its manifest's address, or one on this machine; a live one at its edge. Errors come as the `error` event. */
  load(source: string | LocalFiles, start: Start | null = null): Promise<void> {
    this.close();
    return this.lifecycle.load(source, start);
  }

  /** Try again after an error, where it happened. */
  retry(): void {
    this.lifecycle.retry();
  }

  /** Close the reel: nothing of it is left, and time is 0. */
  close(): void {
    this.lifecycle.close();
    this.playback.forgetSeek();
    this.played.clear();
  }

  /** Use what the page has asked for before the player was here. */
  offer(prefetched: Prefetched): void {
    this.lifecycle.offer(prefetched);
  }

  private opened(reel: Reel): void {
    this.rendition = this.choice;
    this.soundtrack.open(reel);
    if (!this.paused) this.soundtrack.ask();
  }

  emit(name: string): void {
    this.dispatchEvent(new Event(name));
  }

  /** Whether a reel was given, wherever it is. */
  get hasSource(): boolean {
    return this.lifecycle.hasSource;
  }

  /** The poster that the page has asked for already, "" where it has none for this reel. */
  get prefetchedPoster(): string {
    return this.lifecycle.prefetchedPoster;
  }

  /** What belongs to the reel that is open; null while there is none, or nobody looks. */
  get session(): Session | null {
    return this.lifecycle.session;
  }

  /** The camera people steer; null until the manifest is here. */
  get camera(): OrbitCamera | null {
    return this.lifecycle.camera;
  }

  get error(): Error | null {
    return this.lifecycle.error;
  }

  get stage(): Stage | null {
    return this.session?.stage ?? null;
  }

  get stream(): Stream | null {
    return this.session?.stream ?? null;
  }

  get manifest(): Manifest | null {
    return this.clock.manifest;
  }

  /** Where the reel begins, seconds: what was before may have been dropped. */
  get earliest(): number {
    return this.clock.earliest;
  }

  /** Where it ends, seconds; of a live reel, what there is so far. */
  get duration(): number {
    return this.clock.duration;
  }

  get live(): boolean {
    return this.clock.live;
  }

  get currentTime(): number {
    return this.manifest ? this.clock.seconds : this.lifecycle.startSeconds;
  }

  set currentTime(seconds: number) {
    const time = finite(seconds, "currentTime");
    if (this.manifest) this.playback.seek(time);
    else this.lifecycle.startAt(time);
  }

  get loop(): boolean {
    return this.clock.loop;
  }

  set loop(loop: boolean) {
    this.clock.loop = loop;
  }

  get playbackRate(): number {
    return this.clock.rate;
  }

  set playbackRate(rate: number) {
    this.clock.rate = finite(rate, "playbackRate");
    this.emit("ratechange");
  }

  /** Names of what there is to choose from, best first. */
  get renditions(): string[] {
    return this.manifest?.renditions ?? [];
  }

  /** The rendition that is to be shown, from the next group on that does not show yet; null: whichever does best. */
  get rendition(): string | null {
    return this.choice;
  }

  set rendition(name: string | null) {
    this.choice = name;
    // A reel that has none of this name plays as it does best.
    this.stream?.choose(name !== null && this.renditions.includes(name) ? name : null);
    this.emit("progress");
  }

  /** The rendition that shows. */
  get shownRendition(): string | null {
    const moment = this.stream && this.manifest && this.clock.moment;
    return moment ? this.stream!.renditionOf(moment.current.group) : null;
  }

  get paused(): boolean {
    return !this.clock.playing;
  }

  get seeking(): boolean {
    return this.playback.seeking;
  }

  get ended(): boolean {
    return this.clock.ended;
  }

  /** Time moves on only when this is false: data is missing. */
  get waiting(): boolean {
    return this.playback.stalled || this.playback.soundLate;
  }

  /** What is missing is being got: there is something to wait for. */
  get busy(): boolean {
    const { session, stream } = this;
    return session !== null && !this.error && (!stream || (!this.deferred && (this.waiting || stream.busy)));
  }

  /** Of the bytes that are waited for, the part that is here, 0..1. */
  get progress(): number {
    return this.stream?.progress ?? 0;
  }

  /** Why it takes so long, for people; null while there is nothing to say. */
  get notice(): string | null {
    return this.session?.trouble ?? this.stream?.trouble ?? this.soundtrack.trouble;
  }

  /** A headset shows the reel. */
  get presented(): boolean {
    return this.playback.inHeadset;
  }

  /** True once a whole picture has been shown. */
  get canPlay(): boolean {
    return this.playback.ready;
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    return this.stream?.buffered ?? [];
  }

  /** Seconds that are here beyond the present time. */
  get ahead(): number {
    const { seconds } = this.clock;
    return (this.buffered.find(([start, end]) => start <= seconds && seconds <= end)?.[1] ?? seconds) - seconds;
  }

  /** How the player is doing. */
  get stats(): Stats | null {
    const { session, stage, stream, manifest, canvas, resolution, shownRendition: rendition, ahead } = this;
    return session && stage && stream && manifest ? measure({ stage, stream, decoders: session.decoders, manifest, canvas, resolution, rendition, ahead, moment: this.clock.moment }) : null;
  }

  /** automatic: a page's wish, which is fulfilled in silence where the browser does not allow sound. */
  play(automatic = false): void {
    if (this.clock.playing) return;
    if (this.ended) this.currentTime = this.earliest;
    this.clock.start();
    this.soundtrack.ask(automatic);
    this.emit("play");
    if (this.waiting) this.emit("waiting");
  }

  pause(): void {
    if (!this.clock.playing) return;
    this.clock.stop();
    this.playback.pause();
    this.emit("pause");
  }

  /** Pause, and go some frames on or back. */
  step(frames: number): void {
    if (!this.manifest) return;
    this.pause();
    this.currentTime = this.clock.timeAfter(frames);
  }

  /** The camera or the size changed: draw again. */
  invalidate(): void {
    this.resolution.move();
    this.stage?.invalidate();
  }

  /** The view in as many pixels as the device keeps up with; null while the canvas has no size. */
  get view(): View | null {
    const ratio = this.resolution.ratio;
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    return this.camera && width > 0 && height > 0 ? this.camera.view(width, height) : null;
  }

  /** Resolves when a whole picture has been shown; rejects on an error. */
  whenReady(): Promise<void> {
    return waitUntil(this, "canplay", () => this.canPlay);
  }

  /** RGBA bytes of one settled picture of exactly this pose and size. Throws `TypeError` where a number is none. */
  async renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    for (const size of [width, height]) finite(size, "A picture's size");
    finite(seconds, "seconds");
    const { K, viewmat } = checkedPose(pose);
    await this.whenReady();
    this.pause();
    this.currentTime = seconds;
    await waitUntil(this, "seeked", () => !this.seeking);
    const near = this.manifest?.near ?? 0;
    return this.playback.takePicture({ viewmat, fx: K[0], fy: K[4], cx: K[2], cy: K[5], width, height, near });
  }

}
