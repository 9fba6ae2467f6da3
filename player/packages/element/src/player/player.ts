/** The player: its methods, state and events, for the element and the controls. */
import type { View } from "../base/view";
import { waitUntil } from "../base/wait-until";
import { ENGLISH, type Words } from "../base/words";
import type { OrbitCamera } from "../camera/orbit-camera";
import type { Pose, Start } from "../camera/pose";
import type { Picture, Stage } from "../draw/stage";
import type { LocalFiles } from "@splatreel/decoder/files/local-files";
import type { Manifest } from "@splatreel/decoder/reel/manifest";
import type { Reel } from "@splatreel/decoder/reel/reel";
import { Soundtrack } from "../sound/soundtrack";
import type { Stream } from "@splatreel/decoder/stream/stream";
import { checkedPose, finite } from "./checked-arguments";
import { Clock } from "./clock";
import { Lifecycle } from "./lifecycle";
import { Playback } from "./playback";
import { PlayedRanges } from "./played-ranges";
import type { Prefetched } from "./prefetched";
import { Resolution } from "./resolution";
import type { Session } from "./session";
import { measure, type Stats } from "./stats";
import type { TextTracks } from "./text-tracks";

/**
 * Plays a reel on a canvas.
 *
 * Events named as in HTMLMediaElement: emptied, loadstart, loadedmetadata, durationchange, loadeddata (something is drawn, even static
 * points alone), canplay (the first complete frame is drawn), play, playing (time advances), pause, timeupdate, progress, waiting,
 * seeking, seeked, ratechange, volumechange, ended, error. Others: deferred (downloads wait for an interaction, or no longer do),
 * notallowed (the browser requires an interaction before sound), drawn, pathchange (the camera path changed, began or ended),
 * trackchange (captions or chapters arrived, or others are shown), sectionchange (another part repeats).
 */
export class Player extends EventTarget {
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  readonly playback = new Playback(this);
  readonly soundtrack = new Soundtrack((event) => this.emit(event), () => this.pause());

  /** Played ranges. */
  readonly played = new PlayedRanges();

  /** Texts for people, in the language of the element. */
  words: Words = ENGLISH;
  /** Language of the texts. */
  language = "en";
  /** Captions and chapters; null for none. */
  tracks: TextTracks | null = null;

  private readonly lifecycle: Lifecycle;
  private choice: string | null = null;
  private isDeferred = false;
  private showsPage = false;

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

  /** Start or stop drawing, as the element becomes visible or hidden. */
  show(on: boolean): void {
    this.playback.run(on);
  }

  /** Allow downloads and a graphics device, since the element may soon be visible. */
  wake(): void {
    this.lifecycle.wake();
  }

  /** Release memory, network and graphics device. Time and view stay for `wake`. */
  rest(): void {
    if (!this.lifecycle.awake) return;
    this.lifecycle.rest();
    this.soundtrack.release();
    this.emit("progress");
  }

  /** True if only the manifest is downloaded until the first interaction. */
  get deferred(): boolean {
    return this.isDeferred;
  }

  set deferred(deferred: boolean) {
    if (deferred === this.isDeferred) return;
    this.isDeferred = deferred;
    this.playback.askForFiles();
    this.emit("deferred");
  }

  /** Open a reel by the address of its manifest, or a local one. Errors are reported by the `error` event. */
  load(source: string | LocalFiles, start: Start | null = null): Promise<void> {
    this.close();
    return this.lifecycle.load(source, start);
  }

  /** Reopen the reel after an error, at the same time and view. */
  retry(): void {
    this.lifecycle.retry();
  }

  /** Close the reel and go to time 0. */
  close(): void {
    this.lifecycle.close();
    this.playback.forgetSeek();
    this.played.clear();
  }

  /** Use what the page requested before the player was loaded. */
  offer(prefetched: Prefetched): void {
    this.lifecycle.offer(prefetched);
  }

  /** True if the page shows behind the points, because the reel or the page asks for it. */
  get transparent(): boolean {
    return this.showsPage || this.manifest?.transparent === true;
  }

  set transparent(on: boolean) {
    this.showsPage = on;
    if (this.stage) this.stage.transparent = this.transparent;
  }

  private opened(reel: Reel): void {
    this.session!.stage.transparent = this.showsPage || reel.manifest.transparent;
    this.rendition = this.choice;
    this.soundtrack.open(reel);
    if (!this.paused) this.soundtrack.ask();
  }

  /** Dispatch an event. */
  emit(name: string): void {
    this.dispatchEvent(new Event(name));
  }

  /** True if a reel was given. */
  get hasSource(): boolean {
    return this.lifecycle.hasSource;
  }

  /** Address of the poster that the page requested early; "" if there is none for this reel. */
  get prefetchedPoster(): string {
    return this.lifecycle.prefetchedPoster;
  }

  /** Session of the open reel; null if there is none, or while the player rests. */
  get session(): Session | null {
    return this.lifecycle.session;
  }

  /** Interactive camera; null until the manifest arrives. */
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

  /** Start of the reel, in seconds. A live reel may have dropped what was before. */
  get earliest(): number {
    return this.clock.earliest;
  }

  /** End of the reel, in seconds; of a live reel, the end so far. */
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

  /** Part of the reel that repeats, [start, end] in seconds; null for none. Another reel clears it. */
  get section(): readonly [number, number] | null {
    return this.clock.section;
  }

  set section(section: readonly [number, number] | null) {
    this.clock.section = section && [finite(section[0], "section[0]"), finite(section[1], "section[1]")];
    this.emit("sectionchange");
  }

  get playbackRate(): number {
    return this.clock.rate;
  }

  set playbackRate(rate: number) {
    this.clock.rate = finite(rate, "playbackRate");
    this.emit("ratechange");
  }

  /** Names of the renditions, best first. */
  get renditions(): string[] {
    return this.manifest?.renditions ?? [];
  }

  /** The chosen rendition, used from the next group on; null to adapt. */
  get rendition(): string | null {
    return this.choice;
  }

  set rendition(name: string | null) {
    this.choice = name;
    // A reel without a rendition of this name adapts.
    this.stream?.choose(name !== null && this.renditions.includes(name) ? name : null);
    this.emit("progress");
  }

  /** The rendition on screen. */
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

  /** True while playback waits for data or sound. */
  get waiting(): boolean {
    return this.playback.stalled || this.playback.soundLate;
  }

  /** True while files that playback needs are downloading. */
  get busy(): boolean {
    const { session, stream } = this;
    return session !== null && !this.error && (!stream || (!this.deferred && (this.waiting || stream.busy)));
  }

  /** Received part of the bytes that playback waits for, 0 to 1. */
  get progress(): number {
    return this.stream?.progress ?? 0;
  }

  /** Reason for a delay, to show to people; null if there is none. */
  get notice(): string | null {
    return this.session?.trouble ?? this.stream?.trouble ?? this.soundtrack.trouble;
  }

  /** True while a headset shows the reel. */
  get presented(): boolean {
    return this.playback.inHeadset;
  }

  /** True once a complete frame has been drawn. */
  get canPlay(): boolean {
    return this.playback.ready;
  }

  /** Time ranges that can be shown, [start, end] in seconds. */
  get buffered(): [number, number][] {
    return this.stream?.buffered ?? [];
  }

  /** Buffered seconds after the present time. */
  get ahead(): number {
    const { seconds } = this.clock;
    return (this.buffered.find(([start, end]) => start <= seconds && seconds <= end)?.[1] ?? seconds) - seconds;
  }

  /** Statistics; null without an open reel. */
  get stats(): Stats | null {
    const { session, stage, stream, manifest, canvas, resolution, shownRendition: rendition, ahead } = this;
    return session && stage && stream && manifest ? measure({ stage, stream, decoders: session.decoders, manifest, canvas, resolution, rendition, ahead, moment: this.clock.moment }) : null;
  }

  /** Start to play. automatic: play muted if the browser does not allow sound. */
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

  /** Pause, and step by a number of frames. */
  step(frames: number): void {
    if (!this.manifest) return;
    this.pause();
    this.currentTime = this.clock.timeAfter(frames);
  }

  /** Draw again, because the camera or the size changed. */
  invalidate(): void {
    this.resolution.move();
    this.stage?.invalidate();
  }

  /** View of the canvas, at the resolution that the device keeps up with; null while the canvas has no size. */
  get view(): View | null {
    const ratio = this.resolution.ratio;
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    return this.camera && width > 0 && height > 0 ? this.camera.view(width, height) : null;
  }

  /** Resolve once a complete frame has been drawn; reject on an error. */
  whenReady(): Promise<void> {
    return waitUntil(this, "canplay", () => this.canPlay);
  }

  /** Pause, seek, and render one image of this pose and size. Throws `TypeError` for invalid numbers. */
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
