/** The part of <splat-reel> that follows HTMLMediaElement: attributes and states. */
import { PLAIN, plainWords } from "@splatreel/decoder/internal";
import { propertiesOf } from "@splatreel/renderer";
import type { Player } from "../player/player";

/** HTMLElement, or an empty class where there is no page: servers that render pages import the player as well. */
const BaseElement = globalThis.HTMLElement ?? (class {} as typeof HTMLElement);

/** Base class with the properties of HTMLMediaElement. */
export abstract class MediaElement extends propertiesOf<Player>("player")(
  BaseElement,
  ["paused", "ended", "seeking", "live", "renditions", "progress"],
  ["currentTime", "playbackRate", "section", "volume", "muted"],
) {
  /** Values of `networkState`, as in HTMLMediaElement. */
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

  /** "use-credentials" to send cookies to the reel's host, too; "anonymous"; or null, which is the same. */
  get crossOrigin(): string | null {
    const asked = this.getAttribute("crossorigin");
    return asked === null || asked.toLowerCase() === "use-credentials" ? asked && "use-credentials" : "anonymous";
  }

  set crossOrigin(value: string | null) {
    if (value === null) this.removeAttribute("crossorigin");
    else this.setAttribute("crossorigin", value);
  }

  get poster(): string {
    return this.getAttribute("poster") ?? "";
  }

  set poster(value: string) {
    this.setAttribute("poster", value);
  }

  /** "eager", or "lazy" to download and draw only when the element is on screen or near it. */
  get loading(): string {
    return this.getAttribute("loading") === "eager" ? "eager" : "lazy";
  }

  set loading(value: string) {
    this.setAttribute("loading", value);
  }

  /** "auto", "metadata" to download only the manifest until an interaction, or "none" to download nothing. */
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

  /** Seek, like `currentTime`. */
  fastSeek(seconds: number): void {
    this.currentTime = seconds;
  }

  /** Duration in seconds; NaN until the manifest arrives; of a live reel, the duration so far. */
  get duration(): number {
    return this.player.manifest ? this.player.duration : NaN;
  }

  /** The attribute `muted`: start muted. */
  get defaultMuted(): boolean {
    return this.hasAttribute("muted");
  }

  set defaultMuted(on: boolean) {
    this.toggleAttribute("muted", on);
  }

  /** Name of the chosen rendition, or "auto" to adapt. */
  get rendition(): string {
    return this.player.rendition ?? "auto";
  }

  set rendition(name: string) {
    this.player.rendition = name === "auto" ? null : name;
  }

  get buffered(): TimeRanges {
    return timeRanges(this.player.buffered);
  }

  /** Played ranges. */
  get played(): TimeRanges {
    return timeRanges(this.player.played.ranges);
  }

  /** Seekable range: the whole reel, without the part that a live one has dropped. */
  get seekable(): TimeRanges {
    const { manifest, earliest, duration } = this.player;
    return timeRanges(manifest ? [[earliest, duration]] : []);
  }

  /** As in HTMLMediaElement: 0 nothing, 1 metadata, 2 present frame, 3 more, 4 enough to play. */
  get readyState(): number {
    const { player } = this;
    if (!player.manifest) return 0;
    if (!player.canPlay || player.waiting) return 1;
    const left = player.duration - player.currentTime;
    return player.ahead >= Math.min(left, 1) ? 4 : player.ahead > 0.1 ? 3 : 2;
  }

  /** As in HTMLMediaElement: 0 no reel, 1 idle, 2 downloading, 3 the reel cannot be opened. */
  get networkState(): number {
    const { player } = this;
    if (!player.hasSource) return MediaElement.NETWORK_EMPTY;
    if (player.error && !player.manifest) return MediaElement.NETWORK_NO_SOURCE;
    return player.busy ? MediaElement.NETWORK_LOADING : MediaElement.NETWORK_IDLE;
  }

  /** The error; null if there is none. `code` is that of a MediaError: 2 network, 3 decoding, 4 the reel cannot be opened. */
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
