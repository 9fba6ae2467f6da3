/** Plays a camera path: the camera follows it, and the reel's time goes with it, until a hand is on either. */
import { ReelError } from "../base/errors";
import type { CameraPath } from "../camera/camera-path";
import type { Player } from "./player";

/** Paces, in seconds of the reel a second, at which the reel plays by itself; at others it is shown time by time. */
const SLOWEST = 0.25;
const FASTEST = 4;
/** The reel's time may be so far from the path's, seconds, before it jumps. */
const DRIFT = 0.15;

export class PathPlayer {
  private current: CameraPath | null = null;
  /** Tells that the path has come to its end; null: it does not play. */
  private ended: (() => void) | null = null;
  private before = { rate: 1, loop: false };
  /** The reel plays by itself. */
  private runs = false;
  /** The camera has been led to the end. */
  private over = false;
  /** A seek that was under way at the beginning. */
  private settling = false;

  constructor(private readonly player: Player) {
    player.playback.guideCamera((seconds) => this.step(seconds));
    player.addEventListener("emptied", () => this.stop());
  }

  /** Emits `pathchange` at the player. */
  set path(path: CameraPath | null) {
    this.stop();
    this.current = path;
    this.player.emit("pathchange");
  }

  get path(): CameraPath | null {
    return this.current;
  }

  get playing(): boolean {
    return this.ended !== null;
  }

  /** Resolves at the end, or once it was stopped. Throws `ReelError` without a path or a reel. */
  async play(): Promise<void> {
    const { player, path } = this;
    if (!path) throw new ReelError("There is no camera path. Set one, or load a file.");
    if (!player.camera || !player.manifest) throw new ReelError("There is no reel yet. Wait for loadedmetadata.");
    this.stop();
    this.before = { rate: player.playbackRate, loop: player.loop };
    [this.settling, this.runs, this.over] = [player.seeking, false, false];
    player.pause();
    player.loop = false;
    player.camera.follow(path);
    player.playback.scrub(path.at(0).time);
    await new Promise<void>((resolve) => {
      this.ended = resolve;
      player.emit("pathchange");
    });
  }

  stop(): void {
    const { player, ended } = this;
    if (!ended) return;
    this.ended = null;
    if (player.camera?.following?.path === this.current) player.camera.follow(null);
    if (this.runs) player.pause();
    player.playbackRate = this.before.rate;
    player.loop = this.before.loop;
    player.emit("pathchange");
    ended();
  }

  /** Seconds that the camera may go on of those that have passed. */
  private step(seconds: number): number {
    const { player, current: path } = this;
    if (!this.ended || !path) return seconds;
    const ride = player.camera?.following;
    if (!ride && this.over) {
      // A step may have led beyond the end.
      player.pause();
      this.runs = false;
      player.playback.scrub(path.at(path.seconds).time);
    }
    // A hand took the camera, or played, paused or sought; or the path is at its end.
    const taken = player.seeking ? !this.settling : player.paused === this.runs && !player.ended;
    if (ride?.path !== path || taken) {
      this.stop();
      return seconds;
    }
    if (player.seeking || player.waiting || !player.canPlay) return 0;
    this.settling = false;
    const passed = this.lead(path, ride.at, seconds);
    this.over = !path.loop && ride.at + passed >= path.seconds;
    return passed;
  }

  /** Have the reel at the path's time; where it plays by itself, the camera keeps in step with it. */
  private lead(path: CameraPath, at: number, seconds: number): number {
    const { player } = this;
    const { time, pace } = path.at(at + seconds);
    const runs = pace >= SLOWEST && pace <= FASTEST && !player.ended;
    if (runs && Math.abs(player.playbackRate - pace) > 1e-3) player.playbackRate = pace;
    if (runs !== this.runs) {
      this.runs = runs;
      if (runs) player.play(true); // in silence rather than not at all
      else player.pause();
    }
    const ahead = player.currentTime - time;
    if (runs && Math.abs(ahead) < DRIFT) return Math.min(Math.max(seconds + ahead / pace, 0), 2 * seconds);
    if (Math.abs(ahead) > 1e-6 && !(player.ended && time >= player.duration)) player.playback.scrub(time);
    return seconds;
  }
}
