/** Time of the reel that is open, what is needed for it, and one picture a display frame. */
import type { View } from "../base/view";
import type { OrbitCamera } from "../camera/orbit-camera";
import type { Eye } from "../draw/eye";
import type { Scene } from "../draw/scene";
import type { Picture, Stage } from "../draw/stage";
import type { Manifest } from "../reel/manifest";
import type { Soundtrack } from "../sound/soundtrack";
import type { Stream } from "../stream/stream";
import type { Clock } from "./clock";
import type { Resolution } from "./resolution";

/** Longest step of the clock: after a background tab, playback goes on where it was. */
const LONGEST_STEP = 0.25;
/** A picture is seen about as long after it is begun as from one to the next; it is drawn for that later time, by no more than so many seconds. */
const LONGEST_LEAD = 0.033;
/** Ticks after which the stream may think again although nothing happens: what failed has rested, the network may be better. */
const HEARTBEAT = 30;

/** The player, as far as its loop needs it. */
export interface PlaybackHost {
  readonly camera: OrbitCamera | null;
  readonly clock: Clock;
  readonly resolution: Resolution;
  readonly soundtrack: Soundtrack;
  readonly stage: Stage | null;
  readonly stream: Stream | null;
  readonly manifest: Manifest | null;
  readonly view: View | null;
  readonly error: Error | null;
  readonly paused: boolean;
  readonly ended: boolean;
  readonly live: boolean;
  readonly loop: boolean;
  readonly presented: boolean;
  emit(event: string): void;
  invalidate(): void;
  pause(): void;
}

export class Playback {
  /** Data is missing: time stands still. */
  stalled = true;
  /** Sound is missing, and pictures wait for it. */
  late = false;
  seeking = false;
  /** A whole picture has been shown. */
  ready = false;
  /** Something has been drawn, if only what rests. */
  pictured = false;
  /** Time goes on. */
  moving = false;

  /** Says how many seconds the camera may go on of those that have passed: a camera path keeps it in step with the reel. */
  guide: ((seconds: number) => number) | null = null;

  /** A picture is being taken: nothing else is drawn. */
  private held = false;
  private lastTick = 0;
  private ticks = 0;
  private request = 0;

  constructor(private readonly player: PlaybackHost) {}

  /** Draw and let time go on, or stop. */
  run(on: boolean): void {
    cancelAnimationFrame(this.request);
    if (!on) {
      this.moving = false;
      return this.player.soundtrack.rest();
    }
    this.lastTick = performance.now();
    const tick = (now: number): void => {
      this.request = requestAnimationFrame(tick);
      this.tick(now);
    };
    this.request = requestAnimationFrame(tick);
  }

  /** Another reel is opened, or none. A seek stays one. */
  reset(): void {
    [this.stalled, this.late, this.ready, this.pictured, this.moving] = [true, false, false, false, false];
  }

  /** Draw the picture that shows once more, at once and in full; false where there is none. */
  redraw(): boolean {
    const { stage, resolution } = this.player;
    if (!stage?.view || stage.lost || !this.pictured) return false;
    resolution.settle();
    stage.redraw();
    stage.draw(null, this.player.view ?? stage.view);
    return true;
  }

  /** What shows now, as a view sees it, whatever the canvas' size; nothing else is drawn meanwhile. Rejects where the reel was closed. */
  async takePicture(view: View): Promise<Picture> {
    const { stage, manifest, clock } = this.player;
    if (!stage || !manifest) throw new Error("The reel was closed.");
    this.held = true;
    try {
      return await stage.snapshot(this.scene, clock.moment.weight, view);
    } finally {
      this.held = false;
      this.player.invalidate();
    }
  }

  /** What should show now. */
  get scene(): Scene {
    const { clock, stream } = this.player;
    const { current, previous } = clock.moment;
    return { layers: stream!.layersOf(current.group), current, previous };
  }

  /** Whether what rests has most of the points of the first picture, so that it is one without the rest. */
  get layersFill(): boolean {
    const { layers, groups } = this.player.manifest as Manifest;
    const { group } = this.player.clock.moment.current;
    const resting = layers.reduce((sum, layer) => sum + (layer.group <= group ? layer.points : 0), 0);
    return resting >= groups[group].points;
  }

  /** Tell the stream what is needed now, and see whether it is here. */
  update(): void {
    const { player } = this;
    const { stream, stage, clock } = player;
    if (!stream || !stage || player.error) return;
    const { current, previous } = clock.moment;
    const shown = { current: current.group, previous: previous?.group ?? null, inUse: stage.inUse };
    stream.want({ ...shown, frame: clock.frame, rate: clock.rate, loop: player.loop && !player.live });
    const here = stream.has(current.group) && (previous === null || stream.has(previous.group));
    if (here !== this.stalled) return;
    this.stalled = !here;
    if (here) stage.resort();
    else this.moving = false;
    player.emit(here || player.paused ? "progress" : "waiting");
  }

  /** Show another time with the next picture: no seek, which people would ask for. */
  scrub(seconds: number): void {
    const { player } = this;
    player.clock.seek(seconds);
    player.soundtrack.seek();
    player.emit("timeupdate");
    this.update();
    player.invalidate();
  }

  /** A frame of a headset: what it sees, sorted as the head looks. */
  present(now: number, head: View, eyes: Eye[]): void {
    const { stage, camera } = this.player;
    if (!stage || !camera || this.held) return;
    this.pass(now);
    stage.invalidate();
    this.drawOn(stage, head, eyes, now);
  }

  private tick(now: number): void {
    const { player } = this;
    const { stage, camera } = player;
    if (player.presented) return; // the headset's frames count
    if (!stage || !camera || this.held) return void (this.lastTick = now);
    const passed = this.pass(now);
    if (camera.step(this.guide?.(passed) ?? passed)) player.invalidate();
    const view = player.view;
    if (view) this.drawOn(stage, view, null, now);
  }

  /** Let time go on; seconds since the last time. */
  private pass(now: number): number {
    const step = Math.min(Math.max(now - this.lastTick, 0) / 1000, LONGEST_STEP);
    this.lastTick = now;
    this.advance(now / 1000, step);
    if (++this.ticks % HEARTBEAT === 0) this.update();
    return step;
  }

  private drawOn(stage: Stage, view: View, eyes: Eye[] | null, now: number): void {
    const { resolution, stream, clock, soundtrack, manifest } = this.player;
    soundtrack.spatial.listen(view.viewmat, manifest!);
    if (stage.wantsSort) this.startSort(stage, view);
    const before = stage.pictures;
    stage.draw(this.seeking || this.stalled ? null : clock.frame, view, eyes);
    const drawn = stage.pictures > before;
    if (drawn) {
      this.drew();
      this.player.emit("drawn");
    }
    if (resolution.drawn(drawn, now)) stream?.judge(resolution.struggling);
    if (!eyes && this.ready && resolution.rest(now)) stage.redraw();
  }

  private drew(): void {
    if (this.pictured) return;
    this.pictured = true;
    this.player.emit("loadeddata");
  }

  /** now, step: seconds. */
  private advance(now: number, step: number): void {
    const { player } = this;
    const { clock, soundtrack, resolution } = player;
    const wanted = !player.paused && !player.error;
    const running = wanted && this.ready && !this.stalled && !this.seeking;
    if (wanted) soundtrack.want(clock, running);
    const passed = soundtrack.pass(clock, running, now, step, Math.min(resolution.interval / 1000, LONGEST_LEAD));
    this.waitForSound(running && soundtrack.late(clock));
    const before = clock.seconds;
    if (!running || passed === 0) return;
    if (!clock.advance(passed)) return void (this.moving = false);
    if (clock.seconds < before) soundtrack.seek(); // it begins again
    if (!this.moving) {
      this.moving = true;
      player.emit("playing");
    }
    player.emit("timeupdate");
    this.update();
    player.invalidate();
    if (player.ended && !player.loop) {
      player.pause();
      player.emit("ended");
    }
  }

  private waitForSound(late: boolean): void {
    if (late === this.late) return;
    this.late = late;
    if (late) this.moving = false;
    this.player.emit(late ? "waiting" : "progress");
  }

  /** Sort what should show; before the first group, the layers that are here. */
  private startSort(stage: Stage, view: View): void {
    const layers = this.player.stream!.layersReady;
    if (!this.stalled) void this.show(stage, this.scene, view);
    else if (!stage.scene?.current && layers > 0) void this.show(stage, { layers, current: null, previous: null }, view);
  }

  /** Show a scene: then a seek may be over, and the first picture may be whole. */
  private async show(stage: Stage, scene: Scene, view: View): Promise<void> {
    const { player } = this;
    if (!(await stage.sort(scene, view)) || this.stalled || scene.current === null) return;
    if (!this.ready && !player.presented) stage.draw(player.clock.frame, view); // canplay: it has been drawn
    if (this.seeking && scene.current.group === player.clock.moment.current.group) {
      this.seeking = false;
      player.emit("seeked");
      this.update(); // what was on screen before may go now
    }
    if (this.ready) return;
    this.ready = true;
    this.drew();
    player.emit("canplay");
  }
}
