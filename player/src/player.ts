/** Plays a reel on a canvas: the clock, what shows at its time, and one picture a display frame. */
import { OrbitCamera } from "./camera";
import { messageOf } from "./errors";
import { loadManifest, type Manifest } from "./manifest";
import { Renderer, SLOTS, type View } from "./renderer";
import type { Scene } from "./sort-worker";
import { Sorter } from "./sorter";
import { Stream } from "./stream";
import { clampFrame, momentAt, momentOf, type Moment } from "./timeline";

/** A picture taken by `renderAt`: RGBA bytes, top row first. */
export interface Picture {
  width: number;
  height: number;
  data: Uint8Array;
}

/** A pose as the manifest writes cameras: K [9] and viewmat [16], row by row, OpenCV. */
export interface Pose {
  K: number[];
  viewmat: number[];
}

/** Longest step of the clock: after a background tab, playback goes on where it was. */
const LONGEST_STEP = 0.25;

/**
 * Events, named as those of HTMLMediaElement: loadedmetadata, canplay (the first whole picture), play, pause, timeupdate, progress,
 * waiting, playing, seeking, seeked, ended, error.
 */
export class Player extends EventTarget {
  /** The camera people steer; null until the manifest is here. */
  camera: OrbitCamera | null = null;
  manifest: Manifest | null = null;
  error: Error | null = null;
  loop = false;
  playbackRate = 1;
  /** Duration of the last sort, milliseconds. */
  sortMilliseconds = 0;

  private renderer: Renderer | null = null;
  private stream: Stream | null = null;
  private sorter: Sorter | null = null;
  private source = "";
  private seconds = 0;
  private playing = false;
  private stalled = true;
  private seeking = false;
  private ready = false;
  /** The scene of the order on the GPU; what is drawn always fits it. */
  private scene: Scene | null = null;
  private drawnSeconds = 0;
  private dirty = false;
  private sortAgain = false;
  private held = false;
  private lastTick = 0;
  private tickRequest = 0;
  private generation = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    super();
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.fail(new Error("The graphics device was lost. Try again in a moment."));
    });
    const tick = (now: number): void => {
      this.tickRequest = requestAnimationFrame(tick);
      this.tick(now);
    };
    this.tickRequest = requestAnimationFrame(tick);
  }

  /** Open a reel by its manifest's address. Errors come as the `error` event. */
  async load(source: string): Promise<void> {
    this.unload();
    this.source = source;
    const generation = ++this.generation;
    try {
      const manifest = await loadManifest(source);
      if (generation !== this.generation) return;
      this.open(manifest);
    } catch (error) {
      if (generation === this.generation) this.fail(error);
    }
  }

  /** Try again after an error. */
  retry(): void {
    this.error = null;
    const lost = this.canvas.getContext("webgl2")?.isContextLost() === true;
    if (this.stream && !lost) this.stream.retry();
    else void this.load(this.source);
  }

  destroy(): void {
    this.generation++;
    cancelAnimationFrame(this.tickRequest);
    this.unload();
  }

  get duration(): number {
    return this.manifest ? this.manifest.frames / this.manifest.fps : 0;
  }

  get currentTime(): number {
    return this.seconds;
  }

  set currentTime(seconds: number) {
    this.seconds = Math.min(Math.max(seconds, 0), this.duration);
    this.seeking = true;
    this.emit("seeking");
    this.emit("timeupdate");
    this.update();
  }

  get paused(): boolean {
    return !this.playing;
  }

  get ended(): boolean {
    return this.duration > 0 && this.seconds >= this.duration;
  }

  /** Time moves on only when this is false: data is missing. */
  get waiting(): boolean {
    return this.stalled;
  }

  /** True once a whole picture has been shown. */
  get canPlay(): boolean {
    return this.ready;
  }

  /** Time ranges whose groups are here, [start, end] seconds. */
  get buffered(): [number, number][] {
    const { manifest, stream } = this;
    if (!manifest || !stream) return [];
    const ranges: [number, number][] = [];
    for (const index of stream.held.filter((group) => stream.has(group))) {
      const start = manifest.groups[index].firstFrame / manifest.fps;
      const end = (manifest.groups[index + 1]?.firstFrame ?? manifest.frames) / manifest.fps;
      const last = ranges.at(-1);
      if (last && Math.abs(last[1] - start) < 1e-6) last[1] = end;
      else ranges.push([start, end]);
    }
    return ranges;
  }

  play(): void {
    if (this.playing) return;
    if (this.ended) this.currentTime = 0;
    this.playing = true;
    this.emit("play");
  }

  pause(): void {
    if (!this.playing) return;
    this.playing = false;
    this.emit("pause");
  }

  /** The camera or the size changed: draw again. */
  invalidate(): void {
    this.dirty = true;
    this.sortAgain = true;
  }

  /** Resolves when a whole picture has been shown; rejects on an error. */
  whenReady(): Promise<void> {
    return this.until("canplay", () => this.ready);
  }

  /**
   * Pause, go to a time, and draw it for one pose once everything for it is here and sorted.
   * For comparisons: the picture is exactly what the pose asks for, whatever the canvas' size on the page.
   */
  async renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    await this.whenReady();
    this.pause();
    this.currentTime = seconds;
    await this.until("seeked", () => !this.seeking);
    const { sorter, renderer } = this;
    if (!sorter || !renderer) throw new Error("The reel was closed.");
    this.held = true;
    try {
      while (sorter.busy) await new Promise((resolve) => setTimeout(resolve, 1));
      const moment = this.momentNow();
      const scene = this.sceneOf(moment);
      const { K, viewmat } = pose;
      const view: View = { viewmat, fx: K[0], fy: K[4], cx: K[2], cy: K[5], width, height, near: this.manifest!.near };
      await this.sort(scene, view);
      renderer.draw(scene, moment.weight, view);
      return { width, height, data: renderer.readPixels() };
    } finally {
      this.held = false;
      this.invalidate();
    }
  }

  private open(manifest: Manifest): void {
    this.manifest = manifest;
    this.camera = new OrbitCamera(manifest);
    this.renderer = new Renderer(this.canvas, manifest.layers.map((layer) => layer.points), Math.max(...manifest.groups.map((group) => group.points)));
    this.sorter = new Sorter((message) => this.fail(new Error(message)));
    this.stream = new Stream(manifest, SLOTS, {
      layer: (index, file) => {
        this.sorter!.addLayer(index, this.renderer!.addLayer(index, file), file);
        this.arrived();
      },
      group: (index, file) => {
        this.sorter!.addGroup(index, this.renderer!.addGroup(index, file), file);
        this.arrived();
      },
      dropped: (index) => {
        this.renderer!.dropGroup(index);
        this.sorter!.dropGroup(index);
        this.emit("progress");
      },
      failed: (error) => this.fail(error),
    });
    this.seconds = Math.min(this.seconds, this.duration);
    this.emit("loadedmetadata");
    this.update();
  }

  private unload(): void {
    this.stream?.destroy();
    this.sorter?.destroy();
    this.renderer?.destroy();
    [this.stream, this.sorter, this.renderer, this.manifest, this.camera, this.scene] = [null, null, null, null, null, null];
    [this.error, this.ready, this.stalled] = [null, false, true];
  }

  private arrived(): void {
    this.emit("progress");
    this.update();
    this.invalidate();
  }

  private fail(error: unknown): void {
    if (this.error) return;
    this.error = error instanceof Error ? error : new Error(messageOf(error));
    this.emit("error");
  }

  private emit(name: string): void {
    this.dispatchEvent(new Event(name));
  }

  private until(event: string, reached: () => boolean): Promise<void> {
    return new Promise((resolve, reject) => {
      const check = (): void => {
        if (this.error) reject(this.error);
        else if (reached()) resolve();
        else return;
        this.removeEventListener(event, check);
        this.removeEventListener("error", check);
      };
      this.addEventListener(event, check);
      this.addEventListener("error", check);
      check();
    });
  }

  private momentNow(): Moment {
    const { groups, overlap, fps, frames } = this.manifest!;
    // The last frame stays on until the end of its own duration.
    return momentAt(groups, overlap, fps, Math.min(this.seconds, Math.max(frames - 1, 0) / fps));
  }

  private sceneOf({ current, previous }: Moment): Scene {
    return { layers: this.stream!.layersOf(current.group), current, previous };
  }

  /** Tell the stream what is needed now, and see whether it is here. */
  private update(): void {
    const { stream } = this;
    if (!stream) return;
    const { current, previous } = this.momentNow();
    const shown = [this.scene?.current?.group, this.scene?.previous?.group].filter((group) => group !== undefined);
    stream.want(current.group, previous?.group ?? null, shown);
    const here = stream.has(current.group) && (previous === null || stream.has(previous.group));
    if (here !== this.stalled) return;
    this.stalled = !here;
    this.emit(here ? "playing" : "waiting");
  }

  private tick(now: number): void {
    const step = Math.min((now - this.lastTick) / 1000, LONGEST_STEP);
    this.lastTick = now;
    if (!this.stream || !this.camera || this.held) return;
    this.advance(step);
    if (this.camera.step(step)) this.invalidate();
    const view = this.viewNow();
    if (!view) return;
    if (!this.sorter!.busy) this.startSort(view);
    if (this.dirty && this.scene) this.drawNow(view);
  }

  private advance(step: number): void {
    if (!this.playing || this.stalled || this.seeking) return;
    this.seconds += step * this.playbackRate;
    if (this.seconds >= this.duration) {
      if (this.loop) this.seconds %= this.duration;
      else this.seconds = this.duration;
    }
    this.emit("timeupdate");
    this.update();
    this.invalidate();
    if (this.ended && !this.loop) {
      this.pause();
      this.emit("ended");
    }
  }

  private viewNow(): View | null {
    const ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    return width > 0 && height > 0 ? this.camera!.view(width, height) : null;
  }

  /** Sort what should show; without a group, the layers that are here. */
  private startSort(view: View): void {
    if (!this.sortAgain && !this.seeking) return;
    const layers = this.stream!.layersReady;
    const scene = !this.stalled ? this.sceneOf(this.momentNow()) : this.scene?.current ? null : { layers, current: null, previous: null };
    if (!scene || (scene.current === null && layers === 0)) return;
    this.sortAgain = false;
    void this.sort(scene, view);
  }

  private async sort(scene: Scene, view: View): Promise<void> {
    const { sorter, renderer } = this;
    const reply = await sorter!.sort(scene, view);
    // The reel may have been closed, or one of the groups dropped, while the worker was at it.
    if (renderer !== this.renderer || !renderer!.holds(scene)) return;
    this.sortMilliseconds = reply.milliseconds;
    renderer!.setOrder(reply.order, reply.count);
    sorter!.recycle(reply.order);
    this.scene = scene;
    this.dirty = true;
    this.settle(scene);
  }

  /** The scene of a sort has arrived: a seek may be over, the first picture may be whole. */
  private settle(scene: Scene): void {
    if (this.stalled || scene.current === null) return;
    if (this.seeking && scene.current.group === this.momentNow().current.group) {
      this.seeking = false;
      this.emit("seeked");
    }
    if (!this.ready) {
      this.ready = true;
      this.emit("canplay");
    }
  }

  /** Draw the sorted scene at the present time, or, while what belongs to it is not here, at the last one drawn. */
  private drawNow(view: View): void {
    const scene = this.scene!;
    const { groups, overlap, fps } = this.manifest!;
    this.dirty = false;
    if (scene.current === null) {
      this.renderer!.draw(scene, 1, view);
      return;
    }
    const present = Math.min(this.seconds, (this.manifest!.frames - 1) / fps);
    const { firstFrame, frames } = groups[scene.current.group];
    const holds = present * fps >= firstFrame && present * fps <= firstFrame + frames - 1;
    const same = this.momentNow().current.group === scene.current.group;
    if ((holds || same) && !this.seeking && !this.stalled) this.drawnSeconds = present;
    const moment = momentOf(groups, overlap, this.drawnSeconds * fps, scene.current.group);
    const previous = scene.previous && { group: scene.previous.group, frame: clampFrame(groups[scene.previous.group], this.drawnSeconds * fps) };
    this.renderer!.draw({ ...scene, current: moment.current, previous }, previous ? moment.weight : 1, view);
  }
}
