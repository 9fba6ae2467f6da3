/** The player's loop: in each display frame it advances the time, moves the camera, and sorts and draws the scene. */
import type { Scene } from "../draw/scene";
import { layersAt, type Manifest, type Moment, type Stream } from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { Eye } from "../draw/eye";
import type { Picture, Stage } from "../draw/stage";
import type { Soundtrack } from "../sound/soundtrack";
import type { Clock } from "./clock";
import type { PlayedRanges } from "./played-ranges";
import type { Resolution } from "./resolution";

/** Return the scene at a moment. */
function sceneAt({ current, previous }: Moment, { groups }: Manifest): Scene {
  const layers = [previous, current].flatMap((shown) => (shown ? layersAt(groups[shown.group]) : []));
  return { layers: [...new Set(layers.map(({ uri }) => uri))], current, previous };
}

/** Return a scene of the static layers alone, to show before the first group arrives; null if there are none. */
function staticSceneOf({ loadedLayers: layers }: Stream): Scene | null {
  return layers.length > 0 ? { layers, current: null, previous: null } : null;
}

/** Return true if a group has at least as many static as dynamic points, so that a picture without the dynamic ones is worth showing. */
function isMostlyStatic({ groups }: Manifest, { current }: Moment): boolean {
  const group = groups[current.group];
  return layersAt(group).reduce((sum, { points }) => sum + points, 0) >= group.points;
}

/** Maximum step of the clock in seconds, so that playback continues where it was after the tab was hidden. */
const LONGEST_STEP = 0.25;
/** Maximum lead in seconds. A frame appears about one frame interval after drawing begins, so it is drawn for that later time. */
const LONGEST_LEAD = 0.033;
/** Number of ticks between updates of the stream without other events, for retries and better renditions. */
const HEARTBEAT = 30;

/** The part of the player that the loop needs. */
export interface PlaybackHost {
  /** Camera that moves by itself. */
  readonly camera: { step(seconds: number): boolean } | null;
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
  /** True while downloads wait for the first interaction. */
  readonly deferred: boolean;
  readonly ended: boolean;
  readonly live: boolean;
  readonly loop: boolean;
  emit(event: string): void;
  invalidate(): void;
  pause(): void;
}

/** Owns the state of playback. Only `Playback` writes its public fields. */
export class Playback {
  /** True while data is missing, and time stands still. */
  stalled = true;
  /** True while playback waits for sound. */
  soundLate = false;
  /** True from a seek until its frame is drawn. */
  seeking = false;
  /** True once anything has been drawn, even static points alone. */
  hasPicture = false;
  /** True once a complete frame has been drawn. */
  ready = false;
  /** True while time advances. */
  advancing = false;
  /** True while the caller draws, such as a headset or another engine. */
  callerDraws = false;

  /** True while a picture is taken, during which nothing else is drawn. */
  private held = false;
  private guide: ((seconds: number) => number) | null = null;
  private lastTick = 0;
  private ticks = 0;
  private request = 0;

  constructor(private readonly player: PlaybackHost) {}

  /** Start or stop the loop. */
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
    if (this.callerDraws) return;
    if (!stage || !camera || this.held) return void (this.lastTick = now);
    const seconds = this.secondsSinceLast(now);
    this.passTime(now, seconds);
    this.moveCamera(camera, seconds);
    const { view } = this.player;
    if (view) this.drawPicture(stage, view, null, now);
  }

  /** Draw a frame in the loop of the caller. head: view between the eyes, for which points are sorted. moved: it has changed. */
  drawForCaller(now: number, head: View, eyes: Eye[], moved = true): void {
    const { stage, camera } = this.player;
    if (!stage || !camera || this.held) return;
    this.passTime(now, this.secondsSinceLast(now));
    if (moved) stage.invalidate();
    else stage.redraw();
    this.drawPicture(stage, head, eyes, now);
  }

  private secondsSinceLast(now: number): number {
    const seconds = Math.min(Math.max(now - this.lastTick, 0) / 1000, LONGEST_STEP);
    this.lastTick = now;
    return seconds;
  }

  /** Advance the time unless data is missing. If there is sound, its clock leads. now: milliseconds. */
  private passTime(now: number, seconds: number): void {
    const { player } = this;
    const { clock, soundtrack, resolution } = player;
    const wanted = !player.paused && !player.error;
    const running = wanted && this.ready && !this.stalled && !this.seeking;
    if (wanted) soundtrack.want(clock, running);
    const passed = soundtrack.advance(
      clock,
      running,
      now / 1000,
      seconds,
      Math.min(resolution.interval / 1000, LONGEST_LEAD),
    );
    this.waitForSound(running && soundtrack.isLate(clock));
    if (running && passed > 0) this.advance(passed);
    if (++this.ticks % HEARTBEAT === 0) this.askForFiles();
  }

  /** Advance the clock. seconds: of real time. */
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

  /** Move the camera by input, inertia or a path. */
  private moveCamera(camera: { step(seconds: number): boolean }, seconds: number): void {
    if (camera.step(this.guide?.(seconds) ?? seconds)) this.player.invalidate();
  }

  /** Request a sort if needed, and draw the present order. eyes: views of a headset. */
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

  /** Sort the present scene, or the loaded static layers before the first group arrives. */
  private sort(stage: Stage, view: View): void {
    const {
      stream,
      clock: { moment },
      manifest,
    } = this.player;
    if (!this.stalled && moment) return void this.show(stage, sceneAt(moment, manifest!), view);
    const layers = stage.scene?.current ? null : staticSceneOf(stream!);
    if (layers) void this.show(stage, layers, view);
  }

  /** Sort a scene to draw from then on. This may end a seek or complete the first frame. */
  private async show(stage: Stage, scene: Scene, view: View): Promise<void> {
    const { player } = this;
    if (!(await stage.sort(scene, view)) || this.stalled || scene.current === null) return;
    if (!this.ready && !this.callerDraws) stage.draw(player.clock.frame, view); // `canplay` promises a drawn frame
    if (this.seeking && scene.current.group === player.clock.moment?.current.group) {
      this.seeking = false;
      player.emit("seeked");
      this.askForFiles(); // the groups on screen before may be dropped now
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

  /** Update the demand of the stream, and check whether playback stalls. */
  askForFiles(): void {
    const { player } = this;
    const { stream, stage, clock } = player;
    if (!stream || !stage || player.error || player.deferred) return;
    const { moment } = clock;
    const [current, previous] = [moment?.current.group ?? null, moment?.previous?.group ?? null];
    stream.want({
      current,
      previous,
      inUse: stage.inUse,
      frame: clock.frame,
      rate: clock.rate,
      loop: player.loop && !player.live,
    });
    const here = current !== null && stream.has(current) && (previous === null || stream.has(previous));
    if (here !== this.stalled) return;
    this.stalled = !here;
    if (here) stage.resort();
    else this.advancing = false;
    player.emit(here || player.paused ? "progress" : "waiting");
  }

  /** Seek. The player emits `seeked` once the frame is drawn. */
  seek(seconds: number): void {
    const { player } = this;
    player.clock.seek(seconds);
    player.soundtrack.seek();
    [this.seeking, this.advancing] = [true, false];
    player.emit("seeking");
    player.emit("timeupdate");
    this.askForFiles();
    // The old frame stays until the new one is sorted.
    player.resolution.move();
    player.stage?.resort();
  }

  /** Show another time without the events of a seek. */
  scrub(seconds: number): void {
    const { player } = this;
    player.clock.seek(seconds);
    player.soundtrack.seek();
    player.emit("timeupdate");
    this.askForFiles();
    player.invalidate();
  }

  /** Stop the time. */
  pause(): void {
    this.advancing = false;
    this.player.soundtrack.rest();
  }

  /** Reset the state for another reel. A pending seek stays. */
  reset(): void {
    [this.stalled, this.soundLate, this.ready, this.hasPicture, this.advancing] = [true, false, false, false, false];
  }

  /** Cancel a pending seek. */
  forgetSeek(): void {
    this.seeking = false;
  }

  /** Let a path lead the camera. guide: maps the seconds that passed to those by which the camera advances. */
  guideCamera(guide: (seconds: number) => number): void {
    this.guide = guide;
  }

  /** Leave drawing to the caller, which calls `drawForCaller` in each frame. */
  letCallerDraw(): void {
    this.callerDraws = true;
  }

  /** Draw in the frames of the page again. */
  drawInPage(): void {
    this.callerDraws = false;
  }

  /** Redraw the present frame at once in full resolution. Returns false if there is none. */
  redraw(): boolean {
    const { stage, resolution } = this.player;
    if (!stage?.view || stage.lost || this.held || !this.hasPicture) return false;
    resolution.settle();
    stage.redraw();
    stage.draw(null, this.player.view ?? stage.view);
    return true;
  }

  /** Render the present scene for any view and size. Rejects if the reel was closed. */
  async takePicture(view: View): Promise<Picture> {
    const {
      stage,
      clock: { moment },
      manifest,
    } = this.player;
    if (!stage || !manifest || !moment) throw new Error("The reel was closed.");
    this.held = true;
    try {
      return await stage.snapshot(sceneAt(moment, manifest), moment.weight, view);
    } finally {
      this.held = false;
      this.player.invalidate();
    }
  }

  /** True if the scene is mostly static, so that its static points alone are worth showing. */
  get isMostlyStatic(): boolean {
    const { manifest, clock } = this.player;
    const moment = manifest && clock.moment;
    return moment !== null && isMostlyStatic(manifest!, moment);
  }
}
