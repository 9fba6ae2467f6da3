/** Plays one reel in the loop of another renderer: time, sound, files, and the order of points. */
import { type Access, messageOf, Reel } from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { PointSorter } from "../draw/point-sorter";
import type { Renderer } from "../draw/renderer";
import { PlayPromises } from "./play-promises";
import { PlayerCore } from "./player-core";
import { Session } from "./session";

/** Milliseconds without a frame after which the sound pauses. */
const HIDDEN = 500;

/** The player of a reel without a canvas, a camera or controls of its own. */
export class ReelPlayer extends PlayerCore {
  readonly camera = { step: (): boolean => false };
  readonly deferred = false;
  error: Error | null = null;
  /** Time at which the reel opens, in seconds; null for its start. */
  startTime: number | null = null;
  session: Session | null = null;
  private hidden: ReturnType<typeof setTimeout> | undefined;
  private last: View | null = null;
  private readonly promises = new PlayPromises(this, () => super.play(true));

  /** url: address of the manifest. listen: receives the names of events, as in HTMLMediaElement. access: of a private reel. */
  constructor(
    public url: string,
    private readonly listen: (event: string) => void,
    public access: Access = {},
  ) {
    super();
    this.playback.letCallerDraw();
  }

  override emit(event: string): void {
    this.listen(event);
    super.emit(event);
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
      const reel = this.clock.reel ?? new Reel(await session.findManifest(this.url, this.access));
      if (session.closed) return;
      const isFirst = this.clock.reel === null;
      session.open(reel);
      this.clock.open(reel);
      this.soundtrack.open(reel);
      this.chooseAgain();
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

  /** Close the reel for good: pending and later promises reject. */
  dispose(): void {
    this.pause();
    this.close();
    this.soundtrack.release();
    this.error ??= new Error(`${this.url} was closed: its object was disposed of.`);
    super.emit("error"); // the object's listeners hear of failures only
  }

  get hasSource(): boolean {
    return this.url !== "";
  }

  /** Advance the time and draw. head: view for which points are sorted. */
  draw(view: View, head: View, moved: boolean): void {
    this.last = view;
    clearTimeout(this.hidden);
    this.hidden = setTimeout(() => this.soundtrack.rest(), HIDDEN);
    this.playback.drawForCaller(performance.now(), head, [{ framebuffer: null, x: 0, y: 0, view }], moved);
  }

  get view(): View | null {
    return this.last;
  }

  protected get startSeconds(): number {
    return this.startTime ?? 0;
  }

  protected set startSeconds(seconds: number) {
    this.startTime = seconds;
  }

  /** Start to play, muted if the browser does not allow sound. Resolves once time advances; rejects as in HTMLMediaElement. */
  override play(): Promise<void> {
    return this.promises.play();
  }

  invalidate(): void {
    this.stage?.invalidate();
  }

  /** True if the direction and distance of the sound follow the camera, for reels whose sound has a position. */
  get positional(): boolean {
    return this.soundtrack.spatial.on;
  }

  set positional(on: boolean) {
    this.soundtrack.spatial.on = on;
  }

  /** Number of points drawn. */
  get points(): number {
    return this.stage?.points ?? 0;
  }

  /** Color behind the points, sRGB, 0 to 1; null before the manifest arrives. The scene's background is drawn instead. */
  get background(): [number, number, number] | null {
    return this.manifest?.background ?? null;
  }

  private fail(error: unknown): void {
    if (this.error) return;
    this.session?.abandon();
    this.error = error instanceof Error ? error : new Error(messageOf(error));
    this.emit("error");
  }
}
