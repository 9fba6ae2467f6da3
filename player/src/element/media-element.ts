/** What <splat-reel> has in common with <video>: attributes, and states in the terms of HTMLMediaElement. */
import { PLAIN, plainWords } from "../base/errors";
import type { Player } from "../player/player";

export abstract class MediaElement extends HTMLElement {
  /** As of HTMLMediaElement, for `networkState`. */
  static readonly NETWORK_EMPTY = 0;
  static readonly NETWORK_IDLE = 1;
  static readonly NETWORK_LOADING = 2;
  static readonly NETWORK_NO_SOURCE = 3;

  /** The player behind the element. */
  abstract readonly player: Player;

  get src(): string {
    return this.getAttribute("src") ?? "";
  }

  set src(value: string) {
    this.setAttribute("src", value);
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

  /** "auto"; "metadata": until people ask for pictures no more than the manifest is got; "none": nothing is. */
  get preload(): string {
    const asked = (this.getAttribute("preload") ?? "").toLowerCase();
    return asked === "none" || asked === "metadata" ? asked : "auto";
  }

  set preload(value: string) {
    this.setAttribute("preload", value);
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

  /** The same: every time of a reel can be gone to at once. */
  fastSeek(seconds: number): void {
    this.currentTime = seconds;
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
    return timeRanges(this.player.buffered);
  }

  /** What has been played. */
  get played(): TimeRanges {
    return timeRanges(this.player.played.ranges);
  }

  /** Where time can go: all of the reel, but for what a live one has dropped. */
  get seekable(): TimeRanges {
    const { manifest, earliest, duration } = this.player;
    return timeRanges(manifest ? [[earliest, duration]] : []);
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
    if (!player.hasSource) return MediaElement.NETWORK_EMPTY;
    if (player.error && !player.manifest) return MediaElement.NETWORK_NO_SOURCE;
    return player.busy ? MediaElement.NETWORK_LOADING : MediaElement.NETWORK_IDLE;
  }

  /** The share of the bytes being waited for that has arrived, 0..1. */
  get progress(): number {
    return this.player.progress;
  }

  /** `code` is that of a MediaError: 2 network, 3 decoding, 4 the reel cannot be opened. */
  get error(): (Error & { readonly code: number }) | null {
    const { error, manifest } = this.player;
    if (!error) return null;
    const network: string[] = [PLAIN.network, PLAIN.missing, PLAIN.refused];
    return Object.assign(error, { code: !manifest ? 4 : network.includes(plainWords(error)) ? 2 : 3 });
  }
}

function timeRanges(ranges: readonly [number, number][]): TimeRanges {
  return { length: ranges.length, start: (i: number) => ranges[i][0], end: (i: number) => ranges[i][1] };
}
