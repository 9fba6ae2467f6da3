/** Plays a reel on a canvas: opening and closing it, its states and events; `playback` draws it. */
import { DeviceLostError, messageOf } from "../base/errors";
import type { View } from "../base/view";
import { until } from "../base/wait-until";
import { OrbitCamera } from "../camera/orbit-camera";
import type { CameraState, Pose, Start } from "../camera/pose";
import { reachable } from "../camera/reachable";
import type { Picture, Stage } from "../draw/stage";
import type { LocalFiles } from "../files/local-files";
import type { Manifest } from "../reel/manifest";
import { Soundtrack } from "../sound/soundtrack";
import type { Stream } from "../stream/stream";
import { checkedPose, finite } from "./checked-arguments";
import { Clock } from "./clock";
import { GraphicsContext } from "./graphics-context";
import { Playback } from "./playback";
import type { Prefetched } from "./prefetched";
import { Resolution } from "./resolution";
import { Session, type SessionEvents } from "./session";
import { measure, type Stats } from "./stats";

/**
 * Events, named as those of HTMLMediaElement: emptied, loadstart, loadedmetadata, durationchange, loadeddata (something is drawn, if
 * only what rests), canplay (the first whole picture), play, playing (time goes on), pause, timeupdate, progress, waiting, seeking,
 * seeked, ratechange, volumechange, ended, error; notallowed (no sound before a touch), drawn, pathchange (or it begins or ends).
 */
export class Player extends EventTarget {
  /** The camera people steer; null until the manifest is here. */
  camera: OrbitCamera | null = null;
  error: Error | null = null;
  /** What the page has asked for already, before the player was here. */
  early: Prefetched | null = null;
  /** A headset shows the reel, in frames of its own. */
  presented = false;
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  readonly playback = new Playback(this);
  readonly soundtrack = new Soundtrack((event) => this.emit(event), () => this.pause());
  /** What belongs to the reel that is open; null while there is none, or nobody looks. */
  session: Session | null = null;

  private source: string | LocalFiles = "";
  /** Where to begin, as a link says or a page that does not wait for the manifest. */
  private start: Start | null = null;
  /** Where it broke off. */
  private back: { seconds: number; view: CameraState } | null = null;
  private choice: string | null = null;
  private awake = false;
  /** Counts openings: what an earlier one still waits for comes to nothing. */
  private turn = 0;
  private readonly surface: GraphicsContext;
  private readonly online = (): void => {
    if (this.error) this.retry();
  };

  constructor(readonly canvas: HTMLCanvasElement) {
    super();
    this.surface = new GraphicsContext(canvas, () => this.fail(new DeviceLostError()), () => this.retry());
  }

  /** Whether people look: only then pictures are drawn and time goes on. */
  set shown(on: boolean) {
    this.playback.run(on);
  }

  /** Get files and hold a graphics device from now on: people may soon look. */
  wake(): void {
    if (this.awake) return;
    this.awake = true;
    addEventListener("online", this.online);
    if (this.hasSource && !this.error) void this.begin();
  }

  /** Give back all that takes memory and network. Time and view stay, and `wake` goes on from there. */
  rest(): void {
    if (!this.awake) return;
    this.awake = false;
    removeEventListener("online", this.online);
    this.turn++;
    const had = this.session !== null;
    this.closeSession();
    this.soundtrack.release();
    if (had) this.surface.release();
    this.emit("progress");
  }

  /** Whether a reel was given, wherever it is. */
  get hasSource(): boolean {
    return this.source !== "";
  }

  /** Of the reel's manifest, absolute; empty where there is none, or it is on this machine. */
  get address(): string {
    return typeof this.source === "string" ? this.source : "";
  }

  /** Open a reel by its manifest's address, or one on this machine; a live one at its edge. Errors come as the `error` event. */
  load(source: string | LocalFiles, start: Start | null = null): Promise<void> {
    this.close();
    this.source = source;
    this.start = start;
    return this.awake ? this.begin() : Promise.resolve();
  }

  /** Try again after an error, where it happened. */
  retry(): void {
    if (this.camera) this.back = { seconds: this.currentTime, view: this.camera.state };
    [this.clock.manifest, this.camera] = [null, null];
    void this.begin();
  }

  /** Close the reel: nothing of it is left, and time is 0. */
  close(): void {
    const had = this.hasSource;
    this.closeSession();
    this.turn++;
    [this.source, this.start, this.back, this.error] = ["", null, null, null];
    [this.clock.manifest, this.camera, this.clock.playing, this.clock.seconds] = [null, null, false, 0];
    this.playback.seeking = false;
    if (had) this.emit("emptied");
  }

  private closeSession(): void {
    this.session?.close();
    this.session = null;
    this.soundtrack.close();
    this.playback.reset();
  }

  private async begin(): Promise<void> {
    this.closeSession();
    this.error = null;
    const turn = ++this.turn;
    this.emit("loadstart");
    let session: Session | null = null;
    try {
      if (this.surface.released) await this.surface.acquire();
      if (turn !== this.turn) return void (!this.awake && this.surface.release());
      const early = this.takeEarly();
      session = this.session = new Session(this.canvas, this.sessionEvents(), early?.worker);
      if (session.stage.software) this.resolution.hesitate();
      // What is still known of a reel that was put to rest is as good as anew; a live one has grown.
      const manifest = this.manifest && !this.live ? this.manifest : await session.find(this.source, early?.text);
      if (!session.closed) this.open(session, manifest);
    } catch (error) {
      if (turn === this.turn && !session?.closed) this.fail(error);
    }
  }

  /** What the page asked for, if this is for it; once. */
  private takeEarly(): Prefetched | null {
    const { early, source } = this;
    this.early = null;
    if (early?.url === source) return early;
    early?.worker?.terminate();
    return null;
  }

  private open(session: Session, manifest: Manifest): void {
    session.open(manifest);
    this.clock.manifest = manifest;
    const known = this.camera !== null;
    this.camera ??= this.cameraOf(manifest);
    if (!known) this.clock.seek(this.back?.seconds ?? this.start?.seconds ?? (manifest.live ? this.clock.edge : 0));
    [this.start, this.back] = [null, null];
    this.rendition = this.choice;
    this.soundtrack.open(manifest);
    if (!this.paused) this.soundtrack.ask();
    if (!known) this.emit("loadedmetadata");
    this.emit("durationchange");
    this.playback.update();
  }

  private cameraOf(manifest: Manifest): OrbitCamera {
    const camera = new OrbitCamera(manifest, this.canvas);
    camera.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const view = this.back?.view ?? (this.start?.view ? reachable(this.start.view, manifest) : null);
    if (view) camera.state = view;
    return camera;
  }

  private sessionEvents(): SessionEvents {
    const changed = (event: string): void => (this.emit(event), this.playback.update());
    return {
      arrived: () => changed("progress"),
      grown: () => changed("durationchange"),
      progress: () => this.emit("progress"),
      failed: (error) => this.fail(error),
    };
  }

  /** The reel is closed for what cannot be helped: it begins anew with `retry`. */
  private fail(error: unknown): void {
    if (this.error) return;
    // A lost device fails at whatever is asked of it, before the browser tells of the loss.
    const cause = this.stage?.lost ? new DeviceLostError() : error;
    if (this.session) this.session.broken = true;
    this.error = cause instanceof Error ? cause : new Error(messageOf(cause));
    this.emit("error");
  }

  emit(name: string): void {
    this.dispatchEvent(new Event(name));
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

  /** Seconds; of a live reel, what there is so far. */
  get duration(): number {
    return this.clock.duration;
  }

  get live(): boolean {
    return this.clock.live;
  }

  get currentTime(): number {
    return this.manifest ? this.clock.seconds : (this.start?.seconds ?? 0);
  }

  set currentTime(seconds: number) {
    finite(seconds, "currentTime");
    if (!this.manifest) {
      this.start = { seconds: Math.max(seconds, 0), view: this.start?.view ?? null };
      return;
    }
    this.clock.seek(seconds);
    this.soundtrack.seek();
    [this.playback.seeking, this.playback.moving] = [true, false];
    this.emit("seeking");
    this.emit("timeupdate");
    this.playback.update();
    // The old picture stays as it is until the new one is sorted.
    this.resolution.move();
    this.stage?.resort();
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
    return (this.manifest?.renditions ?? []).map(({ name }) => name);
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
    return this.stream && this.manifest ? this.stream.renditionOf(this.clock.moment.current.group) : null;
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
    return this.playback.stalled || this.playback.late;
  }

  /** What is missing is being got: there is something to wait for. */
  get busy(): boolean {
    const { session, stream } = this;
    return session !== null && !this.error && (!stream || this.waiting || stream.busy);
  }

  /** Of the bytes that are waited for, the part that is here, 0..1. */
  get progress(): number {
    return this.stream?.progress ?? 0;
  }

  /** Why it takes so long, for people; null while there is nothing to say. */
  get notice(): string | null {
    return this.session?.trouble ?? this.stream?.trouble ?? this.soundtrack.trouble;
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
    const { session, stage, stream, manifest, canvas, resolution, shownRendition: rendition, ahead, currentTime } = this;
    return session && stage && stream && manifest ? measure({ stage, stream, decoders: session.decoders, manifest, canvas, resolution, rendition, ahead, currentTime }) : null;
  }

  /** automatic: a page's wish, which is fulfilled in silence where the browser does not allow sound. */
  play(automatic = false): void {
    if (this.clock.playing) return;
    if (this.ended) this.currentTime = 0;
    [this.clock.playing, this.soundtrack.optional] = [true, automatic];
    this.soundtrack.ask();
    this.emit("play");
    if (this.waiting) this.emit("waiting");
  }

  pause(): void {
    if (!this.clock.playing) return;
    [this.clock.playing, this.playback.moving] = [false, false];
    this.soundtrack.rest();
    this.emit("pause");
  }

  /** Pause, and go some frames on or back. */
  step(frames: number): void {
    if (!this.manifest) return;
    this.pause();
    this.currentTime = this.clock.framesOn(frames);
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
    return until(this, "canplay", () => this.canPlay);
  }

  /** RGBA bytes of one settled picture of exactly this pose and size. Throws `TypeError` where a number is none. */
  async renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    for (const size of [width, height]) finite(size, "A picture's size");
    finite(seconds, "seconds");
    const { K, viewmat } = checkedPose(pose);
    await this.whenReady();
    this.pause();
    this.currentTime = seconds;
    await until(this, "seeked", () => !this.seeking);
    const near = this.manifest?.near ?? 0;
    return this.playback.takePicture({ viewmat, fx: K[0], fy: K[4], cx: K[2], cy: K[5], width, height, near });
  }

}
