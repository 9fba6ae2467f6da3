/** The player's loop: once a display frame time goes on, the camera moves, and what shows then is sorted and drawn. */
import type { View } from "../base/view";
import type { OrbitCamera } from "../camera/orbit-camera";
import type { Eye } from "../draw/eye";
import type { Scene } from "../draw/scene";
import type { Picture, Stage } from "../draw/stage";
import type { Manifest } from "../reel/manifest";
import type { Soundtrack } from "../sound/soundtrack";
import type { Stream } from "../stream/stream";
import type { Clock } from "./clock";
import type { PlayedRanges } from "./played-ranges";
import type { Resolution } from "./resolution";
import { isMostlyStatic, sceneAt, staticSceneOf } from "./scene-choice";

/** Longest step of the clock, seconds: after a background tab, playback goes on where it was. */
const LONGEST_STEP = 0.25;
/** A picture is seen about as long after it is begun as from one to the next; it is drawn for that later time, by no more than so many seconds. */
const LONGEST_LEAD = 0.033;
/** Ticks after which the stream may think again although nothing happens: what failed may be tried again, the network may be better. */
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
  readonly played: PlayedRanges;
  /** Files wait until people ask for pictures. */
  readonly deferred: boolean;
  readonly ended: boolean;
  readonly live: boolean;
  readonly loop: boolean;
  emit(event: string): void;
  invalidate(): void;
  pause(): void;
}

/** What is so is written here only. */
export class Playback {
  /** Data is missing: time stands still. */
  stalled = true;
  /** Sound is missing, and pictures wait for it. */
  soundLate = false;
  /** People went to another time, and it does not show yet. */
  seeking = false;
  /** Something has been drawn, if only what rests. */
  hasPicture = false;
  /** A whole picture has been shown. */
  ready = false;
  /** Time goes on. */
  advancing = false;
  /** A headset shows the reel, in frames of its own. */
  inHeadset = false;

  /** A picture is being taken: nothing else is drawn. */
  private held = false;
  private guide: ((seconds: number) => number) | null = null;
  private lastTick = 0;
  private ticks = 0;
  private request = 0;

  constructor(private readonly player: PlaybackHost) {}

  /** Draw and let time go on, or stop. */
  run(on: boolean): void {
    cancelAnimationFrame(this.request);
    if (!on) {
      this.advancing = false;
      return this.player.soundtrack.rest();
    }
    this.lastTick = performance.now();
    const tick = (now: number): void => {
      this.request = requestAnimationFrame(tick);
      this.tick(now);
    };
    this.request = requestAnimationFrame(tick);
  }

  /** One display frame. */
  private tick(now: number): void {
    const { stage, camera } = this.player;
    if (this.inHeadset) return; // which has frames of its own
    if (!stage || !camera || this.held) return void (this.lastTick = now);
    const seconds = this.secondsSinceLast(now);
    this.passTime(now, seconds);
    this.moveCamera(camera, seconds);
    const { view } = this.player;
    if (view) this.drawPicture(stage, view, null, now);
  }

  /** A frame of a headset: what it sees, sorted as the head looks. */
  tickInHeadset(now: number, head: View, eyes: Eye[]): void {
    const { stage, camera } = this.player;
    if (!stage || !camera || this.held) return;
    this.passTime(now, this.secondsSinceLast(now));
    stage.invalidate();
    this.drawPicture(stage, head, eyes, now);
  }

  private secondsSinceLast(now: number): number {
    const seconds = Math.min(Math.max(now - this.lastTick, 0) / 1000, LONGEST_STEP);
    this.lastTick = now;
    return seconds;
  }

  /** Let time go on, as long as nothing is missing, at the pace of the sound where there is any. now: milliseconds. */
  private passTime(now: number, seconds: number): void {
    const { player } = this;
    const { clock, soundtrack, resolution } = player;
    const wanted = !player.paused && !player.error;
    const running = wanted && this.ready && !this.stalled && !this.seeking;
    if (wanted) soundtrack.want(clock, running);
    const passed = soundtrack.advance(clock, running, now / 1000, seconds, Math.min(resolution.interval / 1000, LONGEST_LEAD));
    this.waitForSound(running && soundtrack.isLate(clock));
    if (running && passed > 0) this.advance(passed);
    if (++this.ticks % HEARTBEAT === 0) this.askForFiles();
  }

  /** Seconds of the reel's own pace. */
  private advance(seconds: number): void {
    const { player } = this;
    const { clock, soundtrack } = player;
    const before = clock.seconds;
    if (!clock.advance(seconds)) return void (this.advancing = false);
    const again = clock.seconds < before;
    if (again) soundtrack.seek();
    player.played.add(before, again ? clock.duration : clock.seconds);
    if (again) player.played.add(clock.earliest, clock.seconds);
    if (!this.advancing) {
      this.advancing = true;
      player.emit("playing");
    }
    player.emit("timeupdate");
    this.askForFiles();
    player.invalidate();
    if (player.ended && !player.loop) {
      player.pause();
      player.emit("ended");
    }
  }

  /** By what moves it: people, inertia, or a path, which says how far. */
  private moveCamera(camera: OrbitCamera, seconds: number): void {
    if (camera.step(this.guide?.(seconds) ?? seconds)) this.player.invalidate();
  }

  /** Have what shows now sorted for a view, and draw what is sorted. eyes: of a headset. */
  private drawPicture(stage: Stage, view: View, eyes: Eye[] | null, now: number): void {
    const { resolution, stream, clock, soundtrack, manifest } = this.player;
    soundtrack.spatial.listen(view.viewmat, manifest!);
    if (stage.wantsSort) this.sort(stage, view);
    const before = stage.pictures;
    stage.draw(this.seeking || this.stalled ? null : clock.frame, view, eyes);
    const drawn = stage.pictures > before;
    if (drawn) {
      this.noteFirstPicture();
      this.player.emit("drawn");
    }
    if (resolution.drawn(drawn, now)) stream?.judge(resolution.struggling);
    if (!eyes && this.ready && resolution.becomesStill(now)) stage.redraw();
  }

  /** Before the first group is here, the static layers that are. */
  private sort(stage: Stage, view: View): void {
    const { stream, clock: { moment }, manifest } = this.player;
    if (!this.stalled && moment) return void this.show(stage, sceneAt(moment, manifest!), view);
    const layers = stage.scene?.current ? null : staticSceneOf(stream!);
    if (layers) void this.show(stage, layers, view);
  }

  /** Sort a scene, which is what is drawn from then on: then a seek may be over, and the first picture may be whole. */
  private async show(stage: Stage, scene: Scene, view: View): Promise<void> {
    const { player } = this;
    if (!(await stage.sort(scene, view)) || this.stalled || scene.current === null) return;
    if (!this.ready && !this.inHeadset) stage.draw(player.clock.frame, view); // canplay: it has been drawn
    if (this.seeking && scene.current.group === player.clock.moment?.current.group) {
      this.seeking = false;
      player.emit("seeked");
      this.askForFiles(); // what was on screen before may go now
    }
    if (this.ready) return;
    this.ready = true;
    this.noteFirstPicture();
    player.emit("canplay");
  }

  private noteFirstPicture(): void {
    if (this.hasPicture) return;
    this.hasPicture = true;
    this.player.emit("loadeddata");
  }

  private waitForSound(late: boolean): void {
    if (late === this.soundLate) return;
    this.soundLate = late;
    if (late) this.advancing = false;
    this.player.emit(late ? "waiting" : "progress");
  }

  /** Tell the stream what is needed now, and see whether it is here. */
  askForFiles(): void {
    const { player } = this;
    const { stream, stage, clock } = player;
    if (!stream || !stage || player.error || player.deferred) return;
    const { moment } = clock;
    const [current, previous] = [moment?.current.group ?? null, moment?.previous?.group ?? null];
    stream.want({ current, previous, inUse: stage.inUse, frame: clock.frame, rate: clock.rate, loop: player.loop && !player.live });
    const here = current !== null && stream.has(current) && (previous === null || stream.has(previous));
    if (here !== this.stalled) return;
    this.stalled = !here;
    if (here) stage.resort();
    else this.advancing = false;
    player.emit(here || player.paused ? "progress" : "waiting");
  }

  /** Go to a time that people ask for: `seeked` comes once it shows. */
  seek(seconds: number): void {
    const { player } = this;
    player.clock.seek(seconds);
    player.soundtrack.seek();
    [this.seeking, this.advancing] = [true, false];
    player.emit("seeking");
    player.emit("timeupdate");
    this.askForFiles();
    // The old picture stays as it is until the new one is sorted.
    player.resolution.move();
    player.stage?.resort();
  }

  /** Show another time with the next picture: no seek, which people would ask for. */
  scrub(seconds: number): void {
    const { player } = this;
    player.clock.seek(seconds);
    player.soundtrack.seek();
    player.emit("timeupdate");
    this.askForFiles();
    player.invalidate();
  }

  /** Time stands still from now on. */
  pause(): void {
    this.advancing = false;
    this.player.soundtrack.rest();
  }

  /** Another reel is opened, or none. A seek stays one. */
  reset(): void {
    [this.stalled, this.soundLate, this.ready, this.hasPicture, this.advancing] = [true, false, false, false, false];
  }

  /** The time that people went to is not looked for any more. */
  forgetSeek(): void {
    this.seeking = false;
  }

  /** guide: says how many seconds the camera may go on of those that have passed, to keep in step with the reel. */
  guideCamera(guide: (seconds: number) => number): void {
    this.guide = guide;
  }

  enterHeadset(): void {
    this.inHeadset = true;
  }

  leaveHeadset(): void {
    this.inHeadset = false;
  }

  /** Draw the picture that shows once more, at once and in full; false where there is none. */
  redraw(): boolean {
    const { stage, resolution } = this.player;
    if (!stage?.view || stage.lost || this.held || !this.hasPicture) return false;
    resolution.settle();
    stage.redraw();
    stage.draw(null, this.player.view ?? stage.view);
    return true;
  }

  /** What shows now, as a view sees it, whatever the canvas' size; nothing else is drawn meanwhile. Rejects where the reel was closed. */
  async takePicture(view: View): Promise<Picture> {
    const { stage, clock: { moment }, manifest } = this.player;
    if (!stage || !manifest || !moment) throw new Error("The reel was closed.");
    this.held = true;
    try {
      return await stage.snapshot(sceneAt(moment, manifest), moment.weight, view);
    } finally {
      this.held = false;
      this.player.invalidate();
    }
  }

  /** Whether what rests has most of the points of the first picture, so that it is one without the rest. */
  get isMostlyStatic(): boolean {
    const { manifest, clock } = this.player;
    const moment = manifest && clock.moment;
    return moment !== null && isMostlyStatic(manifest!, moment);
  }
}
