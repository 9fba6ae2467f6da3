/** Plays a camera path: moves the camera and the reel's time along it, until people move the camera or seek, play or pause. */
import { ReelError } from "@splatreel/decoder/internal";
import type { CameraPath } from "../camera/camera-path";
import type { Player } from "./player";

/** Range of rates, in seconds of the reel per second, at which the reel plays. At other rates single frames are shown. */
const SLOWEST = 0.25;
const FASTEST = 4;
/** Seconds by which the reel's time may differ from the path's before it jumps. */
const DRIFT = 0.15;

/** Leads the camera of a player along a path. */
export class PathPlayer {
  private current: CameraPath | null = null;
  /** Resolves the promise of `play`; null while the path does not play. */
  private ended: (() => void) | null = null;
  private before = { rate: 1, loop: false };
  /** True while the reel plays. */
  private runs = false;
  /** True once the camera has reached the end. */
  private over = false;
  /** True while a seek that began before `play` is pending. */
  private settling = false;

  constructor(private readonly player: Player) {
    player.playback.guideCamera((seconds) => this.step(seconds));
    player.addEventListener("emptied", () => this.stop());
  }

  /** Set the path. The player emits `pathchange`. */
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

  /** Play from the start. Resolves at the end or when stopped. Throws `ReelError` without a path or a reel. */
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

  /** Return the seconds by which the camera advances. seconds: time since the last frame. */
  private step(seconds: number): number {
    const { player, current: path } = this;
    if (!this.ended || !path) return seconds;
    const ride = player.camera?.following;
    if (!ride && this.over) {
      // The last step may have gone beyond the end.
      player.pause();
      this.runs = false;
      player.playback.scrub(path.at(path.seconds).time);
    }
    // Stop if people moved the camera or played, paused or sought, or at the end of the path.
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

  /** Bring the reel to the path's time. While the reel plays, the camera follows its clock instead. */
  private lead(path: CameraPath, at: number, seconds: number): number {
    const { player } = this;
    const { time, pace } = path.at(at + seconds);
    const runs = pace >= SLOWEST && pace <= FASTEST && !player.ended;
    if (runs && Math.abs(player.playbackRate - pace) > 1e-3) player.playbackRate = pace;
    if (runs !== this.runs) {
      this.runs = runs;
      if (runs)
        player.play(true); // muted if the browser requires it
      else player.pause();
    }
    const ahead = player.currentTime - time;
    if (runs && Math.abs(ahead) < DRIFT) return Math.min(Math.max(seconds + ahead / pace, 0), 2 * seconds);
    if (Math.abs(ahead) > 1e-6 && !(player.ended && time >= player.duration)) player.playback.scrub(time);
    return seconds;
  }
}
