/** Plays a reel on a canvas: the clock, what shows at its time, and one picture a display frame. */
import { OrbitCamera } from "./camera";
import { Clock } from "./clock";
import { DeviceLostError, messageOf } from "./errors";
import type { LocalFiles } from "./local-files";
import type { Manifest } from "./manifest";
import type { Pose, Start } from "./pose";
import type { Eye, View } from "./renderer";
import { Resolution } from "./resolution";
import { Session, type SessionEvents } from "./session";
import { takeShot } from "./shot";
import type { Scene } from "./sort-worker";
import type { Picture, Stage } from "./stage";
import { measure, type Stats } from "./stats";
import type { Stream } from "./stream";
import { until } from "./until";

/** Longest step of the clock: after a background tab, playback goes on where it was. */
const LONGEST_STEP = 0.25;

/** Ticks after which the stream may think again although nothing happens: what failed has rested, the network may be better. */
const HEARTBEAT = 30;

/**
 * Events, named as those of HTMLMediaElement: loadstart, loadedmetadata, durationchange, canplay (the first whole picture), play,
 * playing, pause, timeupdate, progress, waiting, seeking, seeked, ratechange, ended, error.
 */
export class Player extends EventTarget {
  /** The camera people steer; null until the manifest is here. */
  camera: OrbitCamera | null = null;
  error: Error | null = null;
  /** A headset shows the reel, in frames of its own. */
  presented = false;
  /** A picture is being taken: nothing else is drawn. */
  held = false;
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  /** What belongs to the reel that is open. */
  session: Session | null = null;

  private source: string | LocalFiles = "";
  private start: Start | null = null;
  private choice: string | null = null;
  private stalled = true;
  private isSeeking = false;
  private ready = false;
  private lastTick = 0;
  private tickRequest = 0;
  private ticks = 0;
  private readonly online = (): void => {
    if (this.error) this.retry();
  };

  constructor(readonly canvas: HTMLCanvasElement) {
    super();
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.fail(new DeviceLostError());
    });
    canvas.addEventListener("webglcontextrestored", () => this.retry());
  }

  /** Begin to draw. */
  connect(): void {
    addEventListener("online", this.online);
    const tick = (now: number): void => {
      this.tickRequest = requestAnimationFrame(tick);
      this.tick(now);
    };
    this.tickRequest = requestAnimationFrame(tick);
  }

  /** Close the reel and stop drawing. */
  disconnect(): void {
    removeEventListener("online", this.online);
    cancelAnimationFrame(this.tickRequest);
    this.close();
  }

  /** Open a reel by its manifest's address, or one on this machine; a live one at its edge. Errors come as the `error` event. */
  load(source: string | LocalFiles, start: Start | null = null): Promise<void> {
    this.source = source;
    this.start = start;
    return this.begin();
  }

  /** Try again after an error, where it happened. */
  retry(): void {
    if (this.camera) this.start = { seconds: this.currentTime, view: this.camera.state };
    void this.begin();
  }

  private async begin(): Promise<void> {
    this.close();
    this.emit("loadstart");
    let session: Session | null = null;
    try {
      session = this.session = new Session(this.canvas, this.sessionEvents());
      if (session.stage.software) this.resolution.hesitate();
      const manifest = await session.find(this.source);
      if (!session.closed) this.open(session, manifest);
    } catch (error) {
      if (!session?.closed) this.fail(error);
    }
  }

  private sessionEvents(): SessionEvents {
    const changed = (event: string): void => (this.emit(event), this.update());
    return {
      arrived: () => changed("progress"),
      grown: () => changed("durationchange"),
      progress: () => this.emit("progress"),
      failed: (error) => this.fail(error),
    };
  }

  /** Close the reel. */
  close(): void {
    this.session?.close();
    [this.session, this.clock.manifest, this.camera] = [null, null, null];
    [this.error, this.ready, this.stalled, this.isSeeking] = [null, false, true, false];
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
    return this.clock.seconds;
  }

  set currentTime(seconds: number) {
    this.clock.seek(seconds);
    this.isSeeking = true;
    this.emit("seeking");
    this.emit("timeupdate");
    this.update();
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
    this.clock.rate = rate;
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
    return this.isSeeking;
  }

  get ended(): boolean {
    return this.clock.ended;
  }

  /** Time moves on only when this is false: data is missing. */
  get waiting(): boolean {
    return this.stalled;
  }

  /** Why it takes so long, for people; null while there is nothing to say. */
  get notice(): string | null {
    return this.session?.trouble ?? this.stream?.trouble ?? null;
  }

  /** True once a whole picture has been shown. */
  get canPlay(): boolean {
    return this.ready;
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
    return this.stage && this.stream && this.manifest ? measure(this) : null;
  }

  play(): void {
    if (this.clock.playing) return;
    if (this.ended) this.currentTime = 0;
    this.clock.playing = true;
    this.emit("play");
  }

  pause(): void {
    if (!this.clock.playing) return;
    this.clock.playing = false;
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

  /** Resolves when a whole picture has been shown; rejects on an error. */
  whenReady(): Promise<void> {
    return until(this, "canplay", () => this.ready);
  }

  /** RGBA bytes of one settled picture of exactly this pose and size. */
  renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    return takeShot(this, seconds, pose, width, height);
  }

  private open(session: Session, manifest: Manifest): void {
    session.open(manifest);
    this.clock.manifest = manifest;
    this.camera = new OrbitCamera(manifest);
    this.camera.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.start?.view) this.camera.state = this.start.view;
    this.clock.seek(this.start?.seconds ?? (manifest.live ? this.clock.edge : 0));
    this.rendition = this.choice;
    this.emit("loadedmetadata");
    this.emit("durationchange");
    this.update();
  }

  private fail(error: unknown): void {
    if (this.error) return;
    // A lost device fails at whatever is asked of it, before the browser tells of the loss.
    const cause = this.stage?.lost ? new DeviceLostError() : error;
    if (this.session) this.session.broken = true; // it begins anew
    this.error = cause instanceof Error ? cause : new Error(messageOf(cause));
    this.emit("error");
  }

  private emit(name: string): void {
    this.dispatchEvent(new Event(name));
  }

  /** What should show now. */
  get scene(): Scene {
    const { current, previous } = this.clock.moment;
    return { layers: this.stream!.layersOf(current.group), current, previous };
  }

  /** Tell the stream what is needed now, and see whether it is here. */
  private update(): void {
    const { stream, stage } = this;
    if (!stream || !stage || this.error) return;
    const { current, previous } = this.clock.moment;
    const { frame, rate } = this.clock;
    const shown = { current: current.group, previous: previous?.group ?? null, inUse: stage.inUse };
    stream.want({ ...shown, frame, rate, loop: this.loop && !this.live });
    const here = stream.has(current.group) && (previous === null || stream.has(previous.group));
    if (here !== this.stalled) return;
    this.stalled = !here;
    if (here) stage.resort();
    this.emit(here ? "playing" : "waiting");
  }

  /** A frame of a headset: what it sees, sorted as the head looks. */
  present(now: number, head: View, eyes: Eye[]): void {
    const { stage } = this;
    if (!stage || !this.camera || this.held) return;
    this.pass(now);
    stage.invalidate();
    this.drawOn(stage, head, eyes, now);
  }

  private tick(now: number): void {
    const { stage, camera } = this;
    if (this.presented) return; // the headset's frames count
    if (!stage || !camera || this.held) return void (this.lastTick = now);
    if (camera.step(this.pass(now))) this.invalidate();
    const view = this.view;
    if (view) this.drawOn(stage, view, null, now);
  }

  /** Let time go on; seconds since the last time. */
  private pass(now: number): number {
    const step = Math.min((now - this.lastTick) / 1000, LONGEST_STEP);
    this.lastTick = now;
    this.advance(step);
    if (++this.ticks % HEARTBEAT === 0) this.update();
    return step;
  }

  private drawOn(stage: Stage, view: View, eyes: Eye[] | null, now: number): void {
    if (stage.wantsSort) this.startSort(stage, view);
    const before = stage.pictures;
    stage.draw(this.isSeeking || this.stalled ? null : this.clock.frame, view, eyes);
    if (this.resolution.drawn(stage.pictures > before, now)) this.stream?.judge(this.resolution.struggling);
    if (!eyes && this.ready && this.resolution.rest(now)) stage.redraw();
  }

  private advance(step: number): void {
    if (this.paused || !this.ready || this.stalled || this.isSeeking || this.error) return;
    if (!this.clock.advance(step)) return;
    this.emit("timeupdate");
    this.update();
    this.invalidate();
    if (this.ended && !this.loop) {
      this.pause();
      this.emit("ended");
    }
  }

  /** The view in as many pixels as the device keeps up with; null while the canvas has no size. */
  get view(): View | null {
    const ratio = this.resolution.ratio;
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    return this.camera && width > 0 && height > 0 ? this.camera.view(width, height) : null;
  }

  /** Sort what should show; before the first group, the layers that are here. */
  private startSort(stage: Stage, view: View): void {
    const layers = this.stream!.layersReady;
    if (!this.stalled) void this.show(stage, this.scene, view);
    else if (!stage.scene?.current && layers > 0) void this.show(stage, { layers, current: null, previous: null }, view);
  }

  /** Show a scene: then a seek may be over, and the first picture may be whole. */
  private async show(stage: Stage, scene: Scene, view: View): Promise<void> {
    if (!(await stage.sort(scene, view)) || this.stalled || scene.current === null) return;
    if (!this.ready && !this.presented) stage.draw(this.clock.frame, view); // canplay: it has been drawn
    if (this.isSeeking && scene.current.group === this.clock.moment.current.group) {
      this.isSeeking = false;
      this.emit("seeked");
      this.update(); // what was on screen before may go now
    }
    if (this.ready) return;
    this.ready = true;
    this.emit("canplay");
  }
}
