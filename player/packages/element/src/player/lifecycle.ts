/** Opens and closes reels: creates the session of a reel, ends it while nobody looks, and begins it again later or after an error. */
import { type Clock, type GraphicsDevice, Session, type SessionEvents, Sorter, WebglDevice } from "@splatreel/renderer";
import {
  type Access,
  DeviceLostError,
  type LocalFiles,
  type Manifest,
  messageOf,
  Reel,
} from "@splatreel/decoder/internal";
import { OrbitCamera } from "../camera/orbit-camera";
import type { CameraState, Start } from "../camera/pose";
import { reachable } from "../camera/reachable";
import type { Prefetched } from "./prefetched";

/** Return the graphics device of a canvas. onlost, onrestored: called when the browser takes the device away and when it returns. */
function graphicsDeviceOf(canvas: HTMLCanvasElement, onlost: () => void, onrestored: () => void): GraphicsDevice {
  return new WebglDevice(canvas, onlost, onrestored);
}

/** The part of the player that opening a reel needs. */
export interface LifecycleHost {
  readonly canvas: HTMLCanvasElement;
  readonly clock: Clock;
  /** How the files of a private reel are requested. */
  readonly access: Access;
  emit(event: string): void;
  /** The browser draws in software. */
  drawsInSoftware(): void;
  /** The manifest is here; `loadedmetadata` follows. */
  opened(reel: Reel): void;
  /** Files arrived or the manifest grew, so missing data may be here now. */
  changed(): void;
  /** A live reel has new groups, or is complete. */
  grown(): void;
  /** The session of the reel has ended. */
  closed(): void;
}

/** Owns the session, the camera and the error of the reel that is open. */
export class Lifecycle {
  private current: Session | null = null;
  private orbitCamera: OrbitCamera | null = null;
  private failure: Error | null = null;
  private source: string | LocalFiles = "";
  /** Start time and view given by a link or a page. */
  private start: Start | null = null;
  /** Time at which a page wants the next reel to begin, in seconds. It survives `load`. */
  private requestedTime: number | null = null;
  /** Time and view at which playback stopped. */
  private resume: { seconds: number; view: CameraState } | null = null;
  private prefetched: Prefetched | null = null;
  private isAwake = false;
  /** Number of openings, by which a pending opening detects that a later one has begun. */
  private openings = 0;
  private readonly device: GraphicsDevice;
  private readonly online = (): void => {
    if (this.failure) this.retry();
  };

  constructor(private readonly host: LifecycleHost) {
    this.device = graphicsDeviceOf(
      host.canvas,
      () => this.fail(new DeviceLostError()),
      () => this.retry(),
    );
  }

  /** Session of the open reel; null if there is none, or while nobody looks. */
  get session(): Session | null {
    return this.current;
  }

  /** Null until the manifest is here. */
  get camera(): OrbitCamera | null {
    return this.orbitCamera;
  }

  /** True if it may download files and hold a graphics device. */
  get awake(): boolean {
    return this.isAwake;
  }

  get error(): Error | null {
    return this.failure;
  }

  /** True if a reel was given. */
  get hasSource(): boolean {
    return this.source !== "";
  }

  /** Absolute address of the manifest; empty for none and for local files. */
  get address(): string {
    return typeof this.source === "string" ? this.source : "";
  }

  /** Time at which playback will begin, in seconds. */
  get startSeconds(): number {
    return this.requestedTime ?? this.start?.seconds ?? 0;
  }

  startAt(seconds: number): void {
    this.requestedTime = seconds;
  }

  /** Address of the poster that the page has requested early; "" if there is none for this reel. */
  get prefetchedPoster(): string {
    return this.prefetched?.url === this.address ? this.prefetched.image.src : "";
  }

  /** Use what the page has requested early, if it belongs to the next reel. */
  offer(prefetched: Prefetched): void {
    this.prefetched = prefetched;
  }

  /** Open a reel, or wait for `wake` to do so. */
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
    if (had) this.device.release();
  }

  retry(): void {
    const { clock } = this.host;
    if (this.orbitCamera)
      this.resume = { seconds: clock.manifest ? clock.seconds : this.startSeconds, view: this.orbitCamera.state };
    clock.forget();
    this.orbitCamera = null;
    void this.begin();
  }

  close(): void {
    const had = this.hasSource;
    this.closeSession();
    this.openings++;
    [this.source, this.start, this.resume, this.failure, this.orbitCamera] = ["", null, null, null, null];
    this.host.clock.reset();
    if (had) this.host.emit("emptied");
  }

  private closeSession(): void {
    this.current?.close();
    this.current = null;
    this.host.closed();
  }

  private async begin(): Promise<void> {
    const { host, device } = this;
    this.closeSession();
    this.failure = null;
    const opening = ++this.openings;
    host.emit("loadstart");
    let session: Session | null = null;
    try {
      if (device.released) await device.acquire();
      if (opening !== this.openings) return void (!this.isAwake && device.release());
      const prefetched = this.takePrefetched();
      session = this.current = Session.start(
        device.createRenderer(),
        (failed) => new Sorter(failed),
        this.sessionEvents(),
        prefetched?.worker,
      );
      if (session.stage.software) host.drawsInSoftware();
      // The manifest of a reel that was put to rest is still valid, unless the reel is live.
      const known = host.clock.live ? null : host.clock.reel;
      const reel = known ?? new Reel(await session.findManifest(this.source, host.access, prefetched?.text));
      if (!session.closed) this.open(session, reel);
    } catch (error) {
      if (opening === this.openings && !session?.closed) this.fail(error);
    }
  }

  /** Return the early requests once, and only for the address that they were made for. */
  private takePrefetched(): Prefetched | null {
    const { prefetched, source } = this;
    this.prefetched = null;
    if (prefetched?.url === source) return prefetched;
    prefetched?.worker?.worker.terminate();
    return null;
  }

  private open(session: Session, reel: Reel): void {
    const {
      host,
      host: { clock },
    } = this;
    const { manifest } = reel;
    const known = this.orbitCamera !== null;
    session.open(reel);
    clock.open(reel);
    this.orbitCamera ??= this.cameraOf(manifest);
    clock.seek(
      known
        ? clock.seconds
        : (this.requestedTime ?? this.resume?.seconds ?? this.start?.seconds ?? (manifest.live ? clock.edge : 0)),
    );
    [this.start, this.resume, this.requestedTime] = [null, null, null];
    host.opened(reel);
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
      grown: () => {
        host.grown();
        host.emit("durationchange");
        host.changed();
      },
      replaced: () => this.retry(),
      progress: () => host.emit("progress"),
      failed: (error) => this.fail(error),
    };
  }

  /** Stop with an error. `retry` opens the reel again. */
  private fail(error: unknown): void {
    if (this.failure) return;
    // Calls to a lost device fail before the browser reports the loss.
    const cause = this.current?.stage.lost ? new DeviceLostError() : error;
    this.current?.abandon();
    this.failure = cause instanceof Error ? cause : new Error(messageOf(cause));
    this.host.emit("error");
  }
}
