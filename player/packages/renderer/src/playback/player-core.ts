/** What all players of a reel share: its clock, sound and playback, and their properties. */
import type { Stream } from "@splatreel/decoder/internal";
import { propertiesOf } from "../base/delegation";
import { finite } from "../base/finite";
import type { View } from "../base/view";
import { waitUntil } from "../base/wait-until";
import type { Stage } from "../draw/stage";
import { Soundtrack } from "../sound/soundtrack";
import { Clock } from "./clock";
import { PlayedRanges } from "./played-ranges";
import { Playback, type PlaybackHost } from "./playback";
import { Resolution } from "./resolution";
import type { Session } from "./session";

/** Player of one reel at a time. Subclasses open the reel and provide the camera. */
export abstract class PlayerCore
  extends propertiesOf<Soundtrack>("soundtrack")(
    propertiesOf<Clock>("clock")(EventTarget, ["manifest", "live", "earliest", "duration", "ended"], ["loop"]),
    [],
    ["volume", "muted"],
  )
  implements PlaybackHost
{
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  /** Played ranges. */
  readonly played = new PlayedRanges();
  readonly playback = new Playback(this);
  readonly soundtrack = new Soundtrack(
    (event) => this.emit(event),
    () => this.pause(),
  );
  private choice: string | null = null;

  /** Session of the open reel; null if there is none. */
  abstract readonly session: Session | null;
  abstract readonly camera: { step(seconds: number): boolean } | null;
  abstract readonly view: View | null;
  abstract readonly error: Error | null;
  /** True if a reel was given. */
  abstract readonly hasSource: boolean;
  abstract readonly deferred: boolean;
  /** Time at which the next reel begins, in seconds. */
  protected abstract startSeconds: number;

  /** Dispatch an event. */
  emit(name: string): void {
    this.dispatchEvent(new Event(name));
  }

  abstract invalidate(): void;

  get stage(): Stage | null {
    return this.session?.stage ?? null;
  }

  get stream(): Stream | null {
    return this.session?.stream ?? null;
  }

  get currentTime(): number {
    return this.manifest ? this.clock.seconds : this.startSeconds;
  }

  set currentTime(seconds: number) {
    const time = finite(seconds, "currentTime");
    if (this.manifest) this.playback.seek(time);
    else this.startSeconds = Math.max(time, 0);
  }

  get playbackRate(): number {
    return this.clock.rate;
  }

  set playbackRate(rate: number) {
    this.clock.rate = finite(rate, "playbackRate");
    this.emit("ratechange");
  }

  get paused(): boolean {
    return !this.clock.playing;
  }

  get seeking(): boolean {
    return this.playback.seeking;
  }

  /** True while playback waits for data or sound. */
  get waiting(): boolean {
    return this.playback.stalled || this.playback.soundLate;
  }

  /** True once a complete frame has been drawn. */
  get canPlay(): boolean {
    return this.playback.ready;
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
    this.chooseAgain();
  }

  /** Choose the rendition in a reel that was opened later. A reel without a rendition of this name adapts. */
  protected chooseAgain(): void {
    const { choice } = this;
    this.stream?.choose(choice !== null && this.renditions.includes(choice) ? choice : null);
    this.emit("progress");
  }

  /** Start to play. automatic: play muted if the browser does not allow sound. */
  play(automatic = false): void {
    if (this.clock.playing) return;
    if (this.ended) this.currentTime = this.clock.earliest;
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

  /** Resolve once a complete frame has been drawn; reject on an error. */
  whenReady(): Promise<void> {
    return waitUntil(this, "canplay", () => this.canPlay);
  }
}
