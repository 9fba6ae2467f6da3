/** When a reel is open: from its address to its session, given up where nobody looks, and begun again there or after an error. */
import { DeviceLostError, messageOf } from "../base/errors";
import { OrbitCamera } from "../camera/orbit-camera";
import type { CameraState, Start } from "../camera/pose";
import { reachable } from "../camera/reachable";
import type { LocalFiles } from "../files/local-files";
import type { Manifest } from "../reel/manifest";
import type { Clock } from "./clock";
import { GraphicsContext } from "./graphics-context";
import type { Prefetched } from "./prefetched";
import { Session, type SessionEvents } from "./session";

/** The player, as far as opening a reel needs it. */
export interface LifecycleHost {
  readonly canvas: HTMLCanvasElement;
  readonly clock: Clock;
  emit(event: string): void;
  /** The browser draws without a graphics device. */
  drawsBySoftware(): void;
  /** The manifest is here; `loadedmetadata` follows. */
  opened(manifest: Manifest): void;
  /** Files came, or the manifest grew: what was missing may be here. */
  changed(): void;
  /** A live reel has other groups, or is whole. */
  grown(manifest: Manifest): void;
  /** What belonged to the reel is gone. */
  closed(): void;
}

export class Lifecycle {
  private current: Session | null = null;
  private steered: OrbitCamera | null = null;
  private failure: Error | null = null;
  private source: string | LocalFiles = "";
  /** Where to begin, as a link says or a page that does not wait for the manifest. */
  private start: Start | null = null;
  /** Where a page wants the next reel to begin, seconds, whatever is loaded meanwhile. */
  private wanted: number | null = null;
  /** Where it broke off. */
  private resume: { seconds: number; view: CameraState } | null = null;
  private prefetched: Prefetched | null = null;
  private isAwake = false;
  /** Counts openings: what an earlier one still waits for comes to nothing. */
  private openings = 0;
  private readonly context: GraphicsContext;
  private readonly online = (): void => {
    if (this.failure) this.retry();
  };

  constructor(private readonly host: LifecycleHost) {
    this.context = new GraphicsContext(host.canvas, () => this.fail(new DeviceLostError()), () => this.retry());
  }

  /** What belongs to the reel that is open; null while there is none, or nobody looks. */
  get session(): Session | null {
    return this.current;
  }

  /** Null until the manifest is here. */
  get camera(): OrbitCamera | null {
    return this.steered;
  }

  /** It may get files and hold a graphics device. */
  get awake(): boolean {
    return this.isAwake;
  }

  get error(): Error | null {
    return this.failure;
  }

  /** Whether a reel was given, wherever it is. */
  get hasSource(): boolean {
    return this.source !== "";
  }

  /** Of the reel's manifest, absolute; empty where there is none, or it is on this machine. */
  get address(): string {
    return typeof this.source === "string" ? this.source : "";
  }

  /** Where time begins once the manifest is here, seconds. */
  get startSeconds(): number {
    return this.wanted ?? this.start?.seconds ?? 0;
  }

  startAt(seconds: number): void {
    this.wanted = Math.max(seconds, 0);
  }

  /** The poster that the page has asked for already, "" where it has none for this reel. */
  get prefetchedPoster(): string {
    return this.prefetched?.url === this.address ? this.prefetched.image.src : "";
  }

  /** Use what the page has asked for already, if it is for the reel that is opened next. */
  offer(prefetched: Prefetched): void {
    this.prefetched = prefetched;
  }

  /** Open a reel; that before it is closed. */
  load(source: string | LocalFiles, start: Start | null): Promise<void> {
    [this.source, this.start] = [source, start];
    return this.isAwake ? this.begin() : Promise.resolve();
  }

  wake(): void {
    if (this.isAwake) return;
    this.isAwake = true;
    addEventListener("online", this.online);
    if (this.hasSource && !this.failure) void this.begin();
  }

  rest(): void {
    if (!this.isAwake) return;
    this.isAwake = false;
    removeEventListener("online", this.online);
    this.openings++;
    const had = this.current !== null;
    this.closeSession();
    if (had) this.context.release();
  }

  retry(): void {
    const { clock } = this.host;
    if (this.steered) this.resume = { seconds: clock.manifest ? clock.seconds : this.startSeconds, view: this.steered.state };
    clock.forget();
    this.steered = null;
    void this.begin();
  }

  close(): void {
    const had = this.hasSource;
    this.closeSession();
    this.openings++;
    [this.source, this.start, this.resume, this.failure, this.steered] = ["", null, null, null, null];
    this.host.clock.reset();
    if (had) this.host.emit("emptied");
  }

  private closeSession(): void {
    this.current?.close();
    this.current = null;
    this.host.closed();
  }

  private async begin(): Promise<void> {
    const { host, context } = this;
    this.closeSession();
    this.failure = null;
    const opening = ++this.openings;
    host.emit("loadstart");
    let session: Session | null = null;
    try {
      if (context.released) await context.acquire();
      if (opening !== this.openings) return void (!this.isAwake && context.release());
      const prefetched = this.takePrefetched();
      session = this.current = new Session(host.canvas, this.sessionEvents(), prefetched?.worker);
      if (session.stage.software) host.drawsBySoftware();
      // What is still known of a reel that was put to rest is as good as anew; a live one has grown.
      const known = host.clock.live ? null : host.clock.manifest;
      const manifest = known ?? (await session.findManifest(this.source, prefetched?.text));
      if (!session.closed) this.open(session, manifest);
    } catch (error) {
      if (opening === this.openings && !session?.closed) this.fail(error);
    }
  }

  /** Once, and only for the address that it was asked for. */
  private takePrefetched(): Prefetched | null {
    const { prefetched, source } = this;
    this.prefetched = null;
    if (prefetched?.url === source) return prefetched;
    prefetched?.worker?.terminate();
    return null;
  }

  private open(session: Session, manifest: Manifest): void {
    const { host, host: { clock } } = this;
    const known = this.steered !== null;
    session.open(manifest);
    clock.update(manifest);
    this.steered ??= this.cameraOf(manifest);
    clock.seek(known ? clock.seconds : (this.wanted ?? this.resume?.seconds ?? this.start?.seconds ?? (manifest.live ? clock.edge : 0)));
    [this.start, this.resume, this.wanted] = [null, null, null];
    host.opened(manifest);
    if (!known) host.emit("loadedmetadata");
    host.emit("durationchange");
    host.changed();
  }

  private cameraOf(manifest: Manifest): OrbitCamera {
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const camera = new OrbitCamera(manifest, this.host.canvas, calm);
    const view = this.resume?.view ?? (this.start?.view ? reachable(this.start.view, manifest) : null);
    if (view) camera.state = view;
    return camera;
  }

  private sessionEvents(): SessionEvents {
    const { host } = this;
    return {
      arrived: () => (host.emit("progress"), host.changed()),
      grown: (manifest) => {
        host.clock.update(manifest);
        host.grown(manifest);
        host.emit("durationchange");
        host.changed();
      },
      known: (manifest) => host.clock.update(manifest),
      replaced: () => this.retry(),
      progress: () => host.emit("progress"),
      failed: (error) => this.fail(error),
    };
  }

  /** The reel is closed for what cannot be helped: it begins anew with `retry`. */
  private fail(error: unknown): void {
    if (this.failure) return;
    // A lost device fails at whatever is asked of it, before the browser tells of the loss.
    const cause = this.current?.stage.lost ? new DeviceLostError() : error;
    this.current?.abandon();
    this.failure = cause instanceof Error ? cause : new Error(messageOf(cause));
    this.host.emit("error");
  }
}
