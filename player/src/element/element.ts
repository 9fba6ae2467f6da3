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
import { OffCameraFade } from "../ui/off-camera-fade";
import { attachPointerControls } from "../ui/pointer-controls";
import styles from "../ui/ui.css";
import { PlayPromises } from "./play-promises";
import { Poster } from "./poster";
import { Visibility } from "./visibility";

/** Events of the player that the element passes on. */
const EVENTS = ["emptied", "loadstart", "durationchange", "loadedmetadata", "loadeddata", "canplay", "play", "playing", "pause", "waiting"];
EVENTS.push("timeupdate", "progress", "seeking", "seeked", "ratechange", "volumechange", "pathchange", "ended", "error");

const sheet = new CSSStyleSheet();
sheet.replaceSync(styles);

export class SplatReelElement extends HTMLElement {
  static readonly observedAttributes = ["src", "poster", "loop", "muted", "controls", "loading"];

  /** As of HTMLMediaElement, for `networkState`. */
  static readonly NETWORK_EMPTY = 0;
  static readonly NETWORK_IDLE = 1;
  static readonly NETWORK_LOADING = 2;
  static readonly NETWORK_NO_SOURCE = 3;

  /** The player behind the element. */
  readonly player: Player;
  readonly pathPlayer: PathPlayer;
  private readonly canvas = document.createElement("canvas");
  private readonly picture: Poster;
  private readonly presence: Visibility;
  private readonly pending: PlayPromises;
  private files: LocalFiles | null = null;
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
    this.presence = new Visibility(this, this.player, this.picture);
    this.pending = new PlayPromises(this.player);
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
    const resize = new ResizeObserver(() => player.invalidate());
    resize.observe(canvas);
    signal.addEventListener("abort", () => resize.disconnect());
    addEventListener("hashchange", () => this.hasAttribute("share") && this.follow(location.href), { signal });
    for (const name of ["pointerdown", "focusin"]) this.addEventListener(name, () => this.presence.use(), { signal });
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
    if (!this.connection || before === now) return;
    if (name === "src") this.load();
    if (name === "poster") this.picture.give(this.poster);
    if (name === "controls") this.showControls();
    if (name === "loading") this.watch();
  }

  /** Open `src` from the start, or close what is open where there is none. Done by itself when the element enters a page or `src` changes. */
  load(): void {
    const { player } = this;
    const source = this.files ?? this.currentSrc;
    if (source) void player.load(source, this.hasAttribute("share") ? startOf(location.href) : null);
    else player.close();
    this.picture.give(this.poster);
    this.presence.settle();
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (source && this.autoplay && !calm) player.play(true);
  }

  /** Resolves once time goes on. Rejects with a `NotSupportedError` where there is no reel to play, with a `NotAllowedError` where the browser does not let it be heard, with an `AbortError` where `pause` or another reel comes first. */
  play(): Promise<void> {
    this.presence.use();
    return this.pending.play();
  }

  pause(): void {
    this.player.pause();
  }

  /** Pause, go to a time, and take a picture of exactly this pose and size. */
  renderAt(seconds: number, pose: Pose, width: number, height: number): Promise<Picture> {
    return this.presence.attend(() => this.player.renderAt(seconds, pose, width, height));
  }

  get src(): string {
    return this.getAttribute("src") ?? "";
  }

  set src(value: string) {
    this.setAttribute("src", value);
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

  get poster(): string {
    return this.getAttribute("poster") ?? "";
  }

  set poster(value: string) {
    this.setAttribute("poster", value);
  }

  /** "eager", or "lazy": files are got and pictures drawn only where people may soon see them. */
  get loading(): string {
    return this.getAttribute("loading") === "eager" ? "eager" : "lazy";
  }

  set loading(value: string) {
    this.setAttribute("loading", value);
  }

  get autoplay(): boolean {
    return this.hasAttribute("autoplay");
  }

  set autoplay(on: boolean) {
    this.toggleAttribute("autoplay", on);
  }

  get loop(): boolean {
    return this.hasAttribute("loop");
  }

  set loop(on: boolean) {
    this.toggleAttribute("loop", on);
  }

  get controls(): boolean {
    return this.hasAttribute("controls");
  }

  set controls(on: boolean) {
    this.toggleAttribute("controls", on);
  }

  /** Seconds. */
  get currentTime(): number {
    return this.player.currentTime;
  }

  set currentTime(seconds: number) {
    this.player.currentTime = seconds;
  }

  /** Seconds, NaN until the manifest is here; of a live reel, what there is so far. */
  get duration(): number {
    return this.player.manifest ? this.player.duration : NaN;
  }

  get paused(): boolean {
    return this.player.paused;
  }

  get ended(): boolean {
    return this.player.ended;
  }

  get seeking(): boolean {
    return this.player.seeking;
  }

  /** Whether groups are still being added to the reel. */
  get live(): boolean {
    return this.player.live;
  }

  get playbackRate(): number {
    return this.player.playbackRate;
  }

  set playbackRate(rate: number) {
    this.player.playbackRate = rate;
  }

  /** Of the sound, 0 to 1. */
  get volume(): number {
    return this.player.soundtrack.volume;
  }

  set volume(volume: number) {
    this.player.soundtrack.volume = volume;
  }

  get muted(): boolean {
    return this.player.soundtrack.muted;
  }

  set muted(muted: boolean) {
    this.player.soundtrack.muted = muted;
  }

  /** The attribute `muted`: whether it begins in silence. */
  get defaultMuted(): boolean {
    return this.hasAttribute("muted");
  }

  set defaultMuted(on: boolean) {
    this.toggleAttribute("muted", on);
  }

  /** Names of what there is to choose from, best first; empty where there is one rendition only. */
  get renditions(): string[] {
    return this.player.renditions;
  }

  /** A rendition's name, or "auto" for whichever does best. */
  get rendition(): string {
    return this.player.rendition ?? "auto";
  }

  set rendition(name: string) {
    this.player.rendition = name === "auto" ? null : name;
  }

  get buffered(): TimeRanges {
    const ranges = this.player.buffered;
    return { length: ranges.length, start: (i: number) => ranges[i][0], end: (i: number) => ranges[i][1] };
  }

  /** As of HTMLMediaElement: 0 nothing, 1 metadata, 2 the present picture, 3 a little more, 4 enough. */
  get readyState(): number {
    const { player } = this;
    if (!player.manifest) return 0;
    if (!player.canPlay || player.waiting) return 1;
    const left = player.duration - player.currentTime;
    return player.ahead >= Math.min(left, 1) ? 4 : player.ahead > 0.1 ? 3 : 2;
  }

  /** As of HTMLMediaElement: 0 no reel, 1 nothing is being got, 2 something is, 3 the reel cannot be had. */
  get networkState(): number {
    const { player } = this;
    if (!player.hasSource) return SplatReelElement.NETWORK_EMPTY;
    if (player.error && !player.manifest) return SplatReelElement.NETWORK_NO_SOURCE;
    return player.busy ? SplatReelElement.NETWORK_LOADING : SplatReelElement.NETWORK_IDLE;
  }

  /** Of the bytes that people wait for now, the part that is here, 0..1. */
  get progress(): number {
    return this.player.progress;
  }

  get error(): Error | null {
    return this.player.error;
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
    this.srcObject = await (await loadPart<typeof import("../files/open-files")>("open-files.js")).openFiles(list);
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

  private watch(): void {
    this.watching.abort();
    this.watching = new AbortController();
    this.presence.watch(this.loading === "eager", this.watching.signal);
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
