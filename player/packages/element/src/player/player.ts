/** The player: its methods, state and events, for the element and the controls. */
import { finite, type Picture, PlayerCore, propertiesOf, type View, waitUntil } from "@splatreel/renderer";
import { ENGLISH, type Words } from "../base/words";
import type { Pose, Start } from "../camera/pose";
import type { Access, LocalFiles, Reel } from "@splatreel/decoder/internal";
import { checkedPose } from "./checked-arguments";
import { Lifecycle } from "./lifecycle";
import type { Prefetched } from "./prefetched";
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
export class Player extends propertiesOf<Lifecycle>("lifecycle")(PlayerCore, [
  "hasSource",
  "prefetchedPoster",
  "session",
  "camera",
  "error",
]) {
  /** Texts for people, in the language of the element. */
  words: Words = ENGLISH;
  /** Language of the texts. */
  language = "en";
  /** Captions and chapters; null for none. */
  tracks: TextTracks | null = null;
  /** How the next reel is requested, if it is private. */
  access: Access = {};

  private readonly lifecycle: Lifecycle;
  private isDeferred = false;
  private showsPage = false;

  constructor(readonly canvas: HTMLCanvasElement) {
    super();
    const access = (): Access => this.access;
    this.lifecycle = new Lifecycle({
      canvas,
      get access() {
        return access();
      },
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
    this.chooseAgain();
    this.soundtrack.open(reel);
    if (!this.paused) this.soundtrack.ask();
  }

  protected get startSeconds(): number {
    return this.lifecycle.startSeconds;
  }

  protected set startSeconds(seconds: number) {
    this.lifecycle.startAt(seconds);
  }

  /** Part of the reel that repeats, [start, end] in seconds; null for none. Another reel clears it. */
  get section(): readonly [number, number] | null {
    return this.clock.section;
  }

  set section(section: readonly [number, number] | null) {
    this.clock.section = section && [finite(section[0], "section[0]"), finite(section[1], "section[1]")];
    this.emit("sectionchange");
  }

  /** The rendition on screen. */
  get shownRendition(): string | null {
    const moment = this.stream && this.manifest && this.clock.moment;
    return moment ? this.stream!.renditionOf(moment.current.group) : null;
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
    return this.playback.callerDraws;
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
    return session && stage && stream && manifest
      ? measure({
          stage,
          stream,
          decoders: session.decoders,
          manifest,
          canvas,
          resolution,
          rendition,
          ahead,
          moment: this.clock.moment,
        })
      : null;
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
