/** The sound of the reel that is open. While it is heard it is the clock that pictures follow; else they go by the clock on the wall. */
import { messageOf } from "../base/errors";
import type { Manifest } from "../reel/manifest";
import type { Reel } from "../reel/reel";
import { segmentAt, SoundSource } from "./sound-source";
import { SoundSync } from "./sound-sync";
import { SpatialSound } from "./spatial-sound";

/** Seconds of sound to have ahead. */
const AHEAD = 10;
/** In the last seconds of the sound pictures no longer wait for it: its end is never told exactly. */
const TAIL = 0.1;
/** Sound that stands no more seconds from the pictures goes on from there: they go to it. */
const NEAR = 0.1;
/** Sound that is stretched to another rate is heard so many of its seconds before a browser says so (measured in Chromium). */
const STRETCHED_BEFORE = 0.02;
/** Slowest rate at which browsers play sound. */
const SLOWEST = 0.0625;

/** Where the pictures are, seconds of the reel, and how they go on. */
export interface PictureTime {
  readonly seconds: number;
  readonly rate: number;
  readonly loop: boolean;
  /** Where the reel begins. */
  readonly earliest: number;
  readonly live: boolean;
}

export class Soundtrack {
  /** Why there is no sound; null: there is, or never was. */
  error: Error | null = null;
  /** It is muted because the browser refused to play it, and not because anybody wanted it so. */
  blocked = false;
  readonly spatial = new SpatialSound();

  private reel: Reel | null = null;
  private source: SoundSource | null = null;
  private audio: HTMLAudioElement | null = null;
  /** Where the browser refuses sound, the reel plays in silence instead of not at all. */
  private optional = false;
  private loudness = 1;
  private silenced = false;
  /** The pictures' time was set: sound has to go there. */
  private moved = true;
  private readonly follower = new SoundSync();
  private life = new AbortController();

  /**
   * emit: takes the events volumechange (of whether there is sound, too), progress, and notallowed: the browser lets a page be heard
   * only once a person has touched it. stop: called after the last, unless sound is `optional`.
   */
  constructor(private readonly emit: (event: string) => void, private readonly stop: () => void) {}

  /** Of a reel; nothing is downloaded before it is to be heard. */
  open(reel: Reel): void {
    this.reel = reel;
    this.life = new AbortController();
    const { signal } = this.life;
    // Hidden pages draw nothing, so that there is nothing to be in time with.
    document.addEventListener("visibilitychange", () => this.rest(), { signal });
    // Browsers want a touch of the page first.
    for (const name of ["pointerup", "keyup"]) addEventListener(name, () => this.startSpatialSound(), { signal });
    this.emit("volumechange");
  }

  /** Take over changes of the manifest. */
  refresh(): void {
    this.source?.refresh();
  }

  private get manifest(): Manifest | null {
    return this.reel?.manifest ?? null;
  }

  close(): void {
    this.life.abort();
    this.rest();
    this.source?.close();
    [this.source, this.reel, this.error, this.moved] = [null, null, null, true];
  }

  /** Give all that it holds back, until it is needed again. */
  release(): void {
    this.close();
    this.spatial.close();
    this.audio = null;
  }

  /** The reel has sound that can be played. */
  get available(): boolean {
    return !this.error && Boolean(this.manifest?.presentation.sound);
  }

  /** It comes from a place in the scene. */
  get placed(): boolean {
    return this.available && this.manifest!.presentation.sound!.position !== null;
  }

  get volume(): number {
    return this.loudness;
  }

  /** Throws as that of HTMLMediaElement does. */
  set volume(given: number) {
    const volume = Number(given);
    if (!(volume >= 0 && volume <= 1)) throw new DOMException(`The volume is ${volume}, not within 0 and 1.`, "IndexSizeError");
    const before = this.loudness;
    if (volume === before) return;
    this.loudness = volume;
    if (this.audio) this.audio.volume = volume;
    if (before === 0) this.ask();
    this.emit("volumechange");
  }

  get muted(): boolean {
    return this.silenced;
  }

  set muted(muted: boolean) {
    if (muted === this.silenced) return;
    [this.silenced, this.blocked] = [muted, false];
    if (muted) this.rest();
    else this.ask();
    this.emit("volumechange");
  }

  /** Mute or unmute; what is turned down to nothing comes back loud. */
  toggle(): void {
    if (this.loudness > 0) this.muted = !this.silenced;
    else [this.volume, this.muted] = [1, false];
  }

  /** Why it is late, for people. */
  get trouble(): string | null {
    return this.source?.trouble ?? null;
  }

  /** Ask the browser whether this page may be heard: where a person asked to play, so that it counts as the person's wish. optional: where it may not, play in silence. */
  ask(optional = this.optional): void {
    this.optional = optional;
    const audio = this.heard(1) ? this.prepare() : null;
    if (!audio?.paused) return;
    this.startSpatialSound();
    this.start(audio);
    audio.pause();
  }

  /** Pictures go to another time. */
  seek(): void {
    this.moved = true;
  }

  /** Stand still. */
  rest(): void {
    if (this.audio && !this.audio.paused) this.audio.pause();
  }

  /** Playing has to wait for sound at this time. */
  isLate({ seconds, rate }: PictureTime): boolean {
    return this.heard(rate) && this.covers(seconds) && !this.source?.has(seconds);
  }

  /** Get what is heard at this time and, once there are pictures, after it. */
  want({ seconds, rate, loop, earliest, live }: PictureTime, pictures: boolean): void {
    if (this.heard(rate) && this.prepare()) this.source!.want(seconds, pictures ? AHEAD : TAIL, loop && !live ? earliest : null);
  }

  /**
   * Seconds on the wall that the clock goes on by. running: pictures could go on; now, passed: seconds on the wall, the latter
   * since the last call; shown: seconds from then to when the picture is seen.
   */
  advance(clock: PictureTime, running: boolean, now: number, passed: number, shown: number): number {
    const { seconds, rate } = clock;
    const { audio, source } = this;
    if (!running || !audio || !source || !this.heard(rate) || this.isLate(clock)) {
      this.rest();
      return running && !this.isLate(clock) ? passed : 0;
    }
    // Played again what has ended would begin anew.
    if (!this.covers(seconds) || (audio.ended && !this.moved)) {
      if (!this.within(seconds)) this.moved = true;
      return passed;
    }
    const latency = (this.spatial.latency - shown) * rate - (rate === 1 ? 0 : STRETCHED_BEFORE);
    if (this.follower.recovered) this.moved = true;
    if (audio.playbackRate !== rate) audio.playbackRate = rate;
    if (this.moved || audio.paused) this.begin(audio, seconds, latency);
    return this.follower.follow(audio.currentTime - latency, seconds, rate, now, passed) / rate;
  }

  private begin(audio: HTMLAudioElement, seconds: number, latency: number): void {
    if (this.moved || Math.abs(audio.currentTime - latency - seconds) > NEAR) audio.currentTime = seconds;
    this.moved = false;
    this.follower.restart();
    if (audio.paused) this.start(audio);
  }

  private start(audio: HTMLAudioElement): void {
    audio.play().catch((error: Error) => {
      if (error.name === "NotAllowedError") this.refuse(); // else it was paused meanwhile
    });
  }

  private refuse(): void {
    if (this.optional) {
      this.muted = true;
      this.blocked = true;
      return this.emit("volumechange");
    }
    this.emit("notallowed");
    this.stop();
  }

  /** It is to be heard, at this rate. */
  private heard(rate: number): boolean {
    return this.available && !this.silenced && this.loudness > 0 && rate >= SLOWEST;
  }

  private within(seconds: number): boolean {
    return segmentAt(this.manifest!.presentation.sound!.segments, seconds) >= 0;
  }

  /** There is sound at this time that pictures should wait for. */
  private covers(seconds: number): boolean {
    const last = this.manifest!.presentation.sound!.segments.at(-1);
    return last !== undefined && seconds < last.start + last.seconds - TAIL && this.within(seconds);
  }

  /** The element, with its source; null where the browser does not play it. */
  private prepare(): HTMLAudioElement | null {
    const { reel } = this;
    this.audio ??= this.make();
    if (!this.source) {
      const failed = (error: unknown): void => {
        this.error = error instanceof Error ? error : new Error(messageOf(error));
        console.warn(this.error.message); // for whoever made the reel; people are told that there is no sound
        this.rest();
        this.emit("volumechange");
      };
      try {
        this.source = new SoundSource(this.audio, reel!, { progress: () => this.emit("progress"), renewed: () => this.seek(), failed });
      } catch (error) {
        failed(error);
        return null;
      }
    }
    return this.audio;
  }

  private make(): HTMLAudioElement {
    const audio = new Audio();
    audio.volume = this.loudness;
    audio.preservesPitch = true;
    return audio;
  }

  private startSpatialSound(): void {
    if (this.audio && this.placed) this.spatial.enter(this.audio, this.manifest!.presentation.sound!.channels);
  }
}
