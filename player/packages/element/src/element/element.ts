/** The custom element <splat-reel src="…/manifest.json" poster autoplay loop muted controls>, modeled on <video>. */
import { ENGLISH, LACKING } from "../base/words";
import { parsePath, type PathFile } from "../camera/camera-path";
import { linkTo, startOf } from "../camera/link";
import type { Pose } from "../camera/pose";
import { reachable } from "../camera/reachable";
import { loadPart, type Picture, PlayPromises } from "@splatreel/renderer";
import type { Access, Camera, LocalFiles } from "@splatreel/decoder/internal";
import { checkedViewmat } from "../player/checked-arguments";
import { PathPlayer } from "../player/path-player";
import { Player } from "../player/player";
import type { Stats } from "../player/stats";
import { Controls } from "../ui/controls";
import { CooperativeGestures } from "../ui/cooperative-gestures";
import { FirstPrompt } from "../ui/first-prompt";
import { HostStates } from "../ui/host-states";
import { languageOf, loadWords } from "../ui/language";
import { OffCameraFade } from "../ui/off-camera-fade";
import { attachPointerControls } from "../ui/pointer-controls";
import { skip } from "../ui/skip";
import { adoptStyles } from "../ui/styles";
import styles from "../ui/ui.css";
import { watchAnnotations, watchCamera, watchDrops, watchMedia, watchTracks } from "./part-watch";
import { type FrameCallback, FrameCallbacks } from "./frame-callbacks";
import { MediaElement } from "./media-element";
import { timesOf } from "./media-fragment";
import { Poster } from "./poster";
import { Visibility } from "./visibility";

/** Events of the player that the element dispatches as well. */
const EVENTS = (
  "emptied loadstart durationchange loadedmetadata loadeddata canplay play playing pause " +
  "waiting timeupdate progress seeking seeked ratechange volumechange pathchange ended error"
).split(" ");

/** `<splat-reel>`. */
export class SplatReelElement extends MediaElement {
  static readonly observedAttributes = "src poster loop muted controls loading preload transparent".split(" ");

  /** The player behind the element. */
  readonly player: Player;
  /** Plays camera paths. */
  readonly pathPlayer: PathPlayer;
  /** States for `:state()` of styles. */
  readonly states = new HostStates(this);
  /**
   * Called with the address of each file of the reel before it is requested. Returns headers, such as `Authorization`, or another
   * address. Set it before `src`, or call `load()` afterwards.
   */
  request: Access["request"] = (this as { request?: Access["request"] }).request ?? null; // set before the player was loaded
  private readonly canvas = document.createElement("canvas");
  private readonly picture: Poster;
  private readonly visibility: Visibility;
  private readonly promises: PlayPromises;
  private readonly frames: FrameCallbacks;
  private files: LocalFiles | null = null;
  /** Time at which `src` asks to pause, in seconds; null afterwards. */
  private end: number | null = null;
  private controlsShown: Controls | null = null;
  /** Aborted when the element leaves the page; null outside of a page. */
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
    this.promises = new PlayPromises(this.player, () => this.player.play());
    this.frames = new FrameCallbacks(this.player);
    this.player.addEventListener("timeupdate", () => this.pauseAtEnd());
    for (const name of ["loadedmetadata", "emptied"]) this.player.addEventListener(name, () => this.showPage());
    const root = this.attachShadow({ mode: "open" });
    adoptStyles(root, styles);
    const overlay = document.createElement("slot");
    overlay.name = "overlay";
    root.append(this.canvas, new OffCameraFade(this.player).box, this.picture.image, overlay);
    for (const name of EVENTS) this.player.addEventListener(name, () => this.dispatchEvent(new Event(name)));
  }

  connectedCallback(): void {
    if (this.connection) return; // the element was moved within the page
    const { canvas, player } = this;
    this.connection = new AbortController();
    const { signal } = this.connection;
    this.describe();
    void this.useLanguage(signal);
    const gestures = new CooperativeGestures(this, canvas, () => player.words, signal);
    this.picture.image.after(gestures.hint);
    signal.addEventListener("abort", () => gestures.hint.remove());
    attachPointerControls(canvas, player, gestures, (side) => this.skip(side), signal);
    watchAnnotations(this, player, () => this.say(LACKING), signal);
    watchCamera(this, player, () => this.say(LACKING), signal);
    watchMedia(this, player, this.picture.image, signal);
    if (this.getAttribute("prompt") !== "none") new FirstPrompt(this.shadowRoot!, player, gestures, signal);
    const resize = new ResizeObserver(() => player.invalidate());
    resize.observe(canvas);
    signal.addEventListener("abort", () => resize.disconnect());
    addEventListener("hashchange", () => this.hasAttribute("share") && this.follow(location.href), { signal });
    this.addEventListener("click", () => this.visibility.ask(), { signal });
    for (const name of ["pointerdown", "focusin"])
      this.addEventListener(name, () => this.visibility.interact(), { signal });
    this.showControls();
    watchTracks(
      this,
      ({ Tracks }) => (player.tracks = new Tracks(this, this.shadowRoot!, player, (words) => this.say(words))),
      () => this.say(LACKING),
      signal,
    );
    signal.addEventListener("abort", () => (player.tracks = null));
    if (this.hasAttribute("drop")) watchDrops(this, this.shadowRoot!, () => this.say(LACKING), signal);
    this.watch();
    if (!player.hasSource) this.load();
  }

  disconnectedCallback(): void {
    // Moving an element within the page disconnects and reconnects it at once.
    queueMicrotask(() => void (!this.isConnected && this.leave()));
  }

  /** Stop after the element left the page. Time and view stay. */
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
    if (name === "transparent") {
      this.player.transparent = now !== null;
      this.showPage();
    }
    if (!this.connection) return;
    if (name === "src") this.load(); // setting the same address reloads
    if (before === now) return;
    if (name === "preload") this.visibility.prefer(this.preload, false);
    if (name === "poster") this.picture.give(this.poster);
    if (name === "controls") this.showControls();
    if (name === "loading") this.watch();
  }

  /** Open `src` from the start, or close the reel if there is none. Called automatically when `src` changes. */
  load(): void {
    const { player } = this;
    const source = this.files ?? this.currentSrc.split("#")[0];
    const link = this.hasAttribute("share") ? startOf(location.href) : null;
    const { start, end } = timesOf(this.currentSrc);
    this.end = end;
    this.visibility.prefer(this.preload, true);
    const credentials = this.crossOrigin === "use-credentials" ? "include" : undefined;
    player.access = { credentials, request: this.request };
    if (source) void player.load(source, { seconds: link?.seconds ?? start, view: link?.view ?? null });
    else player.close();
    if (player.deferred) player.emit("deferred"); // update the controls for the new reel
    this.picture.give(this.poster);
    this.visibility.settle();
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (source && this.autoplay && !calm) player.play(true);
  }

  /** Play. Resolves once time advances. Rejects with `NotSupportedError` without a playable reel, `NotAllowedError` if the browser does not allow sound, `AbortError` if interrupted by `pause` or another reel. */
  play(): Promise<void> {
    this.visibility.ask();
    this.visibility.interact();
    return this.promises.play();
  }

  /** Pause. */
  pause(): void {
    this.player.pause();
  }

  /** Pause, seek, and render one image of this pose and size. */
  renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    return this.visibility.keepAwake(() => this.player.renderAt(seconds, pose, width, height));
  }

  /** A local reel, which takes precedence over `src`. */
  get srcObject(): LocalFiles | null {
    return this.files;
  }

  set srcObject(files: LocalFiles | null) {
    this.files = files;
    if (this.isConnected) this.load();
  }

  /** Absolute address of the reel; "" for a local one. */
  get currentSrc(): string {
    return this.files ? "" : this.src && new URL(this.src, document.baseURI).href;
  }

  /** Present view, in the format of the manifest; null until the manifest arrives. Set `viewmat` [16] (world to camera, OpenCV) to move. */
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

  /** Return to the reel's own camera. */
  resetCamera(): void {
    this.player.camera?.reset();
  }

  /** Play a reel from chosen files: a zip, or all files of a folder. Rejects with `ReelError` if there is none among them. */
  async openFiles(files: Iterable<File>): Promise<void> {
    const list = [...files];
    this.srcObject = await (await loadPart("open-files.js", () => import("../files/open-files"))).openFiles(list);
  }

  /** The camera path as JSON (docs/format.md); null for none. Throws `ReelError` for an invalid path. */
  get path(): PathFile | null {
    return this.pathPlayer.path?.toJSON() ?? null;
  }

  set path(path: PathFile | null) {
    this.pathPlayer.path = path === null ? null : parsePath(path, "path");
  }

  /** Play the camera path from its start. Resolves at its end, or when people move the camera, play, pause or seek. */
  playPath(): Promise<void> {
    this.visibility.ask();
    return this.pathPlayer.play();
  }

  /** Statistics; null without an open reel. */
  get stats(): Stats | null {
    return this.player.stats;
  }

  /** Address of the page with the present time and view. An element with the attribute `share` opens such links. */
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

  /** Call a function once with the next frame. Returns a handle for `cancelVideoFrameCallback`. */
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

  private describe(): void {
    const { words: t } = this.player;
    const label = this.getAttribute("aria-label") ?? t("Volumetric video");
    this.canvas.setAttribute(
      "aria-label",
      `${label}. ${t("Drag to look around, scroll to zoom, double-click to choose the middle.")}`,
    );
  }

  /** Show all texts in the language of the page. Until its file arrives, and if it does not, they are English. */
  private async useLanguage(signal: AbortSignal): Promise<void> {
    const language = languageOf(this);
    const words = await loadWords(language).catch(() => null);
    if (signal.aborted || language === this.player.language || (language !== "en" && !words)) return;
    [this.player.words, this.player.language] = [words ?? ENGLISH, language];
    this.describe();
    this.showControls();
  }

  /** Step back or on after a double tap. */
  private skip(side: -1 | 1): void {
    skip(this.player, 0.2 * side, 10);
    this.say(side < 0 ? "Back" : "On");
  }

  /** Show a text for some seconds, if there are controls. */
  private say(words: string): void {
    this.controlsShown?.say(words);
  }

  /** Show the page behind a transparent reel. */
  private showPage(): void {
    this.states.toggle("clear", this.player.transparent);
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
