/** <splat-reel src="…/manifest.json" poster autoplay loop muted controls>: a reel in a page, in the manner of <video>. */
import { parsePath, type PathFile } from "../camera/camera-path";
import { linkTo, startOf } from "../camera/link";
import type { Pose } from "../camera/pose";
import { reachable } from "../camera/reachable";
import type { Picture } from "../draw/stage";
import { loadPart } from "../files/bundle";
import type { LocalFiles } from "../files/local-files";
import { checkedViewmat } from "../player/checked-arguments";
import { PathPlayer } from "../player/path-player";
import { Player } from "../player/player";
import type { Stats } from "../player/stats";
import type { Camera } from "../reel/manifest";
import { Controls } from "../ui/controls";
import { CooperativeGestures } from "../ui/cooperative-gestures";
import { FileDrop } from "../ui/file-drop";
import { FirstPrompt } from "../ui/first-prompt";
import { OffCameraFade } from "../ui/off-camera-fade";
import { attachPointerControls } from "../ui/pointer-controls";
import styles from "../ui/ui.css";
import { FrameCallbacks, type FrameCallback } from "./frame-callbacks";
import { MediaElement } from "./media-element";
import { timesOf } from "./media-fragment";
import { PlayPromises } from "./play-promises";
import { Poster } from "./poster";
import { Visibility } from "./visibility";

/** Events of the player that the element passes on. */
const EVENTS = ["emptied", "loadstart", "durationchange", "loadedmetadata", "loadeddata", "canplay", "play", "playing", "pause", "waiting"];
EVENTS.push("timeupdate", "progress", "seeking", "seeked", "ratechange", "volumechange", "pathchange", "ended", "error");

const sheet = new CSSStyleSheet();
sheet.replaceSync(styles);

export class SplatReelElement extends MediaElement {
  static readonly observedAttributes = ["src", "poster", "loop", "muted", "controls", "loading", "preload"];

  /** The player behind the element. */
  readonly player: Player;
  readonly pathPlayer: PathPlayer;
  private readonly canvas = document.createElement("canvas");
  private readonly picture: Poster;
  private readonly visibility: Visibility;
  private readonly promises: PlayPromises;
  private readonly frames: FrameCallbacks;
  private files: LocalFiles | null = null;
  /** Where `src` says to pause, seconds, until it has. */
  private end: number | null = null;
  private controlsShown: Controls | null = null;
  /** While the element is in a page. */
  private connection: AbortController | null = null;
  private watching = new AbortController();

  constructor() {
    super();
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.player = new Player(this.canvas);
    this.pathPlayer = new PathPlayer(this.player);
    this.picture = new Poster(this.player);
    this.visibility = new Visibility(this, this.player, this.picture);
    this.promises = new PlayPromises(this.player);
    this.frames = new FrameCallbacks(this.player);
    this.player.addEventListener("timeupdate", () => this.pauseAtEnd());
    const root = this.attachShadow({ mode: "open" });
    root.adoptedStyleSheets = [sheet]; // not a style element, which a page's policy may forbid
    root.append(this.canvas, new OffCameraFade(this.player).box, this.picture.image);
    for (const name of EVENTS) this.player.addEventListener(name, () => this.dispatchEvent(new Event(name)));
  }

  connectedCallback(): void {
    if (this.connection) return; // it was moved within the page
    const { canvas, player } = this;
    const label = this.getAttribute("aria-label") ?? "Volumetric video";
    canvas.setAttribute("aria-label", `${label}. Drag to look around, scroll to zoom, double-click to choose the middle.`);
    this.connection = new AbortController();
    const { signal } = this.connection;
    const gestures = new CooperativeGestures(this, canvas, signal);
    this.picture.image.after(gestures.hint);
    signal.addEventListener("abort", () => gestures.hint.remove());
    attachPointerControls(canvas, player, gestures, signal);
    new FirstPrompt(player, gestures, signal);
    const resize = new ResizeObserver(() => player.invalidate());
    resize.observe(canvas);
    signal.addEventListener("abort", () => resize.disconnect());
    addEventListener("hashchange", () => this.hasAttribute("share") && this.follow(location.href), { signal });
    this.addEventListener("click", () => this.visibility.ask(), { signal });
    for (const name of ["pointerdown", "focusin"]) this.addEventListener(name, () => this.visibility.interact(), { signal });
    this.showControls();
    if (this.hasAttribute("drop")) new FileDrop(this, this.shadowRoot!, signal);
    this.watch();
    if (!player.hasSource) this.load();
  }

  disconnectedCallback(): void {
    // What is moved within a page is taken out and put back at once.
    queueMicrotask(() => void (!this.isConnected && this.leave()));
  }

  /** Out of the page: time and view stay, for when it is put back. */
  private leave(): void {
    if (!this.connection) return;
    this.player.pause();
    this.watching.abort();
    this.connection.abort();
    this.connection = null;
    this.controlsShown?.remove();
    this.controlsShown = null;
  }

  attributeChangedCallback(name: string, before: string | null, now: string | null): void {
    if (name === "loop") this.player.loop = now !== null;
    if (name === "muted" && !this.connection && now !== null) this.muted = true;
    if (!this.connection) return;
    if (name === "src") this.load(); // the same one again, too
    if (before === now) return;
    if (name === "preload") this.visibility.prefer(this.preload, false);
    if (name === "poster") this.picture.give(this.poster);
    if (name === "controls") this.showControls();
    if (name === "loading") this.watch();
  }

  /** Open `src` from the start, or close what is open where there is none. Done by itself when the element enters a page or `src` changes. */
  load(): void {
    const { player } = this;
    const source = this.files ?? this.currentSrc.split("#")[0];
    const link = this.hasAttribute("share") ? startOf(location.href) : null;
    const { start, end } = timesOf(this.currentSrc);
    this.end = end;
    this.visibility.prefer(this.preload, true);
    if (source) void player.load(source, { seconds: link?.seconds ?? start, view: link?.view ?? null });
    else player.close();
    if (player.deferred) player.emit("deferred"); // of another reel
    this.picture.give(this.poster);
    this.visibility.settle();
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (source && this.autoplay && !calm) player.play(true);
  }

  /** Resolves once time goes on. Rejects with a `NotSupportedError` where there is no reel to play, with a `NotAllowedError` where the browser does not let it be heard, with an `AbortError` where `pause` or another reel comes first. */
  play(): Promise<void> {
    this.visibility.ask();
    this.visibility.interact();
    return this.promises.play();
  }

  pause(): void {
    this.player.pause();
  }

  /** Pause, go to a time, and take a picture of exactly this pose and size. */
  renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    return this.visibility.keepAwake(() => this.player.renderAt(seconds, pose, width, height));
  }

  /** A reel on this machine; it goes before `src`. */
  get srcObject(): LocalFiles | null {
    return this.files;
  }

  set srcObject(files: LocalFiles | null) {
    this.files = files;
    if (this.isConnected) this.load();
  }

  get currentSrc(): string {
    return this.files ? "" : this.src && new URL(this.src, document.baseURI).href;
  }

  /** The view as the manifest writes cameras; set `viewmat` [16] (world to camera, OpenCV) to move. Null until there is a manifest. */
  get camera(): Camera | null {
    const { camera } = this.player;
    if (!camera) return null;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { viewmat, fx, fy, cx, cy } = camera.view(width, height);
    return { name: "", width, height, K: [fx, 0, cx, 0, fy, cy, 0, 0, 1], viewmat };
  }

  set camera(pose: Pick<Camera, "viewmat"> | null) {
    if (!pose) return;
    const viewmat = checkedViewmat(pose.viewmat);
    if (!this.player.camera) return;
    this.player.camera.viewmat = viewmat;
    this.player.invalidate();
  }

  /** Back to the reel's own camera. */
  resetCamera(): void {
    this.player.camera?.reset();
  }

  /** Play a reel out of files that people chose: a zip, or all of a folder. Rejects with a `ReelError` where there is none among them. */
  async openFiles(files: Iterable<File>): Promise<void> {
    const list = [...files];
    this.srcObject = await (await loadPart("open-files.js", () => import("../files/open-files"))).openFiles(list);
  }

  /** The camera path, as its file holds it (docs/format.md); null: none. Throws `ReelError` for what is no path. */
  get path(): PathFile | null {
    return this.pathPlayer.path?.toJSON() ?? null;
  }

  set path(path: PathFile | null) {
    this.pathPlayer.path = path === null ? null : parsePath(path, "path");
  }

  /** Play it from its beginning. Resolves at its end, or once a hand takes the camera, or plays, pauses or seeks. */
  playPath(): Promise<void> {
    this.visibility.ask();
    return this.pathPlayer.play();
  }

  get stats(): Stats | null {
    return this.player.stats;
  }

  /** This page's address with the present time and view; an element with the attribute `share` opens where such a link says. */
  get link(): string {
    const { camera, currentTime } = this.player;
    return linkTo(location.href, { seconds: currentTime, view: camera?.state ?? null });
  }

  private follow(link: string): void {
    const { seconds, view } = startOf(link);
    if (seconds !== null) this.currentTime = seconds;
    const { camera, manifest } = this.player;
    const sane = view && manifest && reachable(view, manifest);
    if (sane && camera) camera.state = sane;
    this.player.invalidate();
  }

  /** Call once with the next picture, and when and of what time it is. Returns a handle to cancel it by. */
  requestVideoFrameCallback(callback: FrameCallback): number {
    return this.frames.request(callback);
  }

  cancelVideoFrameCallback(handle: number): void {
    this.frames.cancel(handle);
  }

  private pauseAtEnd(): void {
    if (this.end === null || this.paused || this.currentTime < this.end) return;
    this.end = null;
    this.pause();
  }

  private watch(): void {
    this.watching.abort();
    this.watching = new AbortController();
    this.visibility.watch(this.loading === "eager", this.watching.signal);
  }

  private showControls(): void {
    this.controlsShown?.remove();
    this.controlsShown = this.controls ? new Controls(this, this.shadowRoot!, this.player) : null;
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "splat-reel": SplatReelElement;
  }
}
