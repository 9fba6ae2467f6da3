/** Plays one reel in the loop of another renderer: time, sound, files, and the order of points. */
import { messageOf } from "@splatreel/decoder/base/errors";
import type { Manifest } from "@splatreel/decoder/reel/manifest";
import { Reel } from "@splatreel/decoder/reel/reel";
import type { Stream } from "@splatreel/decoder/stream/stream";
import type { View } from "../base/view";
import { waitUntil } from "../base/wait-until";
import type { PointSorter } from "../draw/point-sorter";
import type { Renderer } from "../draw/renderer";
import type { Stage } from "../draw/stage";
import { Clock } from "./clock";
import { PlayedRanges } from "./played-ranges";
import { Playback, type PlaybackHost } from "./playback";
import { Resolution } from "./resolution";
import { Session } from "./session";
import { Soundtrack } from "../sound/soundtrack";

/** Milliseconds without a frame after which the sound pauses. */
const HIDDEN = 500;

/** The player of a reel without a canvas, a camera or controls of its own. */
export class ReelPlayer extends EventTarget implements PlaybackHost {
  readonly clock = new Clock();
  readonly resolution = new Resolution();
  readonly played = new PlayedRanges();
  readonly playback = new Playback(this);
  readonly soundtrack: Soundtrack;
  readonly camera = { step: (): boolean => false };
  readonly deferred = false;
  error: Error | null = null;
  /** Time at which the reel opens, in seconds; null for its start. */
  startTime: number | null = null;
  private session: Session | null = null;
  private choice: string | null = null;
  private hidden: ReturnType<typeof setTimeout> | undefined;
  private last: View | null = null;


  /** url: address of the manifest. listen: receives the names of events, as in HTMLMediaElement. */
  constructor(public url: string, private readonly listen: (event: string) => void) {
    super();
    this.soundtrack = new Soundtrack((event) => this.emit(event), () => this.pause());
    this.playback.enterHeadset(); // the loop is not ours
  }

  emit(event: string): void {
    this.listen(event);
    this.dispatchEvent(new Event(event));
  }

  /** Resolve once a complete frame has been drawn; reject on an error. */
  whenReady(): Promise<void> {
    return waitUntil(this, "canplay", () => this.playback.ready);
  }

  /** Open the reel. Errors are reported by the `error` event. sorterOf: creates what sorts the points; its argument reports failures. */
  async open(renderer: Renderer, sorterOf: (failed: (message: string) => void) => PointSorter): Promise<void> {
    this.emit("loadstart");
    const session = Session.start(renderer, sorterOf, {
      arrived: () => (this.emit("progress"), this.playback.askForFiles()),
      grown: () => {
        this.soundtrack.refresh();
        this.emit("durationchange");
        this.playback.askForFiles();
      },
      replaced: () => this.fail(new Error(`${this.url} was replaced by another reel. Create the object again.`)),
      progress: () => this.emit("progress"),
      failed: (error) => this.fail(error),
    });
    this.session = session;
    try {
      const reel = this.clock.reel ?? new Reel(await session.findManifest(this.url));
      if (session.closed) return;
      const isFirst = this.clock.reel === null;
      session.open(reel);
      this.clock.open(reel);
      this.soundtrack.open(reel);
      this.rendition = this.choice;
      if (isFirst) this.clock.seek(this.startTime ?? (reel.manifest.live ? this.clock.edge : 0));
      if (isFirst) this.emit("loadedmetadata");
      this.emit("durationchange");
      if (!this.paused) this.soundtrack.ask(true);
      this.playback.askForFiles();
    } catch (error) {
      if (!session.closed) this.fail(error);
    }
  }

  /** End the session. The reel, its time and its state stay for another `open`. */
  close(): void {
    clearTimeout(this.hidden);
    this.session?.close();
    this.session = null;
    this.soundtrack.close();
    this.playback.reset();
  }

  /** Advance the time and draw. head: view for which points are sorted. */
  draw(view: View, head: View, moved: boolean): void {
    this.last = view;
    clearTimeout(this.hidden);
    this.hidden = setTimeout(() => this.soundtrack.rest(), HIDDEN);
    this.playback.tickInHeadset(performance.now(), head, [{ framebuffer: null, x: 0, y: 0, view }], moved);
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

  get view(): View | null {
    return this.last;
  }

  get paused(): boolean {
    return !this.clock.playing;
  }

  get ended(): boolean {
    return this.clock.ended;
  }

  get live(): boolean {
    return this.clock.live;
  }

  get loop(): boolean {
    return this.clock.loop;
  }

  get currentTime(): number {
    return this.manifest ? this.clock.seconds : (this.startTime ?? 0);
  }

  set currentTime(seconds: number) {
    if (!Number.isFinite(seconds)) throw new TypeError(`currentTime is ${seconds}, not a finite number.`);
    if (this.manifest) this.playback.seek(seconds);
    else this.startTime = Math.max(seconds, 0);
  }

  get rendition(): string | null {
    return this.choice;
  }

  set rendition(name: string | null) {
    this.choice = name;
    this.stream?.choose(name !== null && this.manifest!.renditions.includes(name) ? name : null);
  }

  play(): void {
    if (this.clock.playing) return;
    if (this.ended) this.currentTime = this.clock.earliest;
    this.clock.start();
    this.soundtrack.ask(true);
    this.emit("play");
  }

  pause(): void {
    if (!this.clock.playing) return;
    this.clock.stop();
    this.playback.pause();
    this.emit("pause");
  }

  invalidate(): void {
    this.stage?.invalidate();
  }

  private fail(error: unknown): void {
    if (this.error) return;
    this.session?.abandon();
    this.error = error instanceof Error ? error : new Error(messageOf(error));
    this.emit("error");
  }
}
