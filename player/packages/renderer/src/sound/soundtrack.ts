/** Sound of the open reel. While audible it is the clock of playback; otherwise the wall clock is. */
import { type Manifest, messageOf, type Reel } from "@splatreel/decoder/internal";
import { segmentAt, SoundSource } from "./sound-source";
import { SpatialSound } from "./spatial-sound";

/** Time constant in seconds for correcting a difference. */
const SMOOTHING = 0.2;
/** Difference in seconds above which the video jumps. */
const JUMP = 0.04;
/** Seconds without a new reading after which the sound has stopped, and the video waits. */
const STOPPED = 0.25;
/** Seconds without a new reading after which the video continues without sound. */
const PATIENCE = 1.5;

/** Computes the steps of the video clock. */
export class SoundSync {
  /** True if the sound moves again after the video continued without it. */
  recovered = false;

  private reading: number | null = null;
  /** Time of the last new reading. */
  private readAt = 0;
  /** True once the reading has changed since the start. */
  private moving = false;
  /** True once the video has reached the sound. */
  private synced = false;
  /** True while the video continues without sound. */
  private lost = false;

  /** Restart after the sound starts or seeks. The video waits until the sound moves. */
  restart(): void {
    [this.reading, this.moving, this.synced, this.recovered] = [null, false, false, false];
  }

  /**
   * Return the step of the video in seconds of the reel, at least 0. sound, pictures: present times of sound and video, in seconds of the
   * reel. now: wall time in seconds; passed: wall time since the last call.
   */
  follow(sound: number, pictures: number, rate: number, now: number, passed: number): number {
    this.read(sound, now);
    const age = now - this.readAt;
    if (this.lost) return passed * rate;
    if (!this.moving || age > STOPPED) return 0;
    const ahead = sound + age * rate - pictures;
    // At the start the video waits for the sound to reach it, or jumps to the sound.
    const step = this.synced ? passed * rate : ahead;
    this.synced ||= ahead >= 0;
    const difference = ahead - step;
    if (Math.abs(difference) > JUMP) return Math.max(ahead, 0);
    return Math.max(step + difference * (1 - Math.exp(-passed / SMOOTHING)), 0);
  }

  private read(sound: number, now: number): void {
    if (sound !== this.reading) {
      this.moving = this.reading !== null;
      [this.reading, this.readAt] = [sound, now];
      if (this.moving) [this.lost, this.recovered] = [false, this.recovered || this.lost];
    } else if (now - this.readAt > PATIENCE) this.lost = true;
  }
}

/** Seconds of sound to buffer ahead. */
const AHEAD = 10;
/** Seconds at the end of the sound for which the video does not wait, since its end is inexact. */
const TAIL = 0.1;
/** Maximum difference in seconds at which the sound resumes without a seek. */
const NEAR = 0.1;
/** Seconds by which time-stretched sound is audible before the browser reports it, measured in Chromium. */
const STRETCH_LEAD = 0.02;
/** Slowest rate at which browsers play sound. */
const SLOWEST = 0.0625;

/** The clock of the video. */
export interface PictureTime {
  readonly seconds: number;
  readonly rate: number;
  readonly loop: boolean;
  /** Start of the reel, in seconds. */
  readonly earliest: number;
  readonly live: boolean;
}

/** Plays the sound of a reel, and leads its clock. */
export class Soundtrack {
  /** Reason why the sound cannot be played; null if it can, or the reel is silent. */
  error: Error | null = null;
  /** True if the sound is muted because the browser did not allow it. */
  blocked = false;
  readonly spatial = new SpatialSound();

  private reel: Reel | null = null;
  private source: SoundSource | null = null;
  private audio: HTMLAudioElement | null = null;
  /** True if the reel plays muted when the browser does not allow sound. */
  private optional = false;
  private loudness = 1;
  private silenced = false;
  /** True if the sound must seek to the time of the video. */
  private moved = true;
  private readonly follower = new SoundSync();
  private life = new AbortController();

  /**
   * emit: receives the events volumechange (also when sound becomes available or not), progress, and notallowed (the browser requires an
   * interaction first). stop: called after notallowed.
   */
  constructor(
    private readonly emit: (event: string) => void,
    private readonly stop: () => void,
  ) {}

  /** Prepare the sound of a reel. Nothing is downloaded before it is audible. */
  open(reel: Reel): void {
    this.reel = reel;
    this.life = new AbortController();
    const { signal } = this.life;
    // A hidden page draws no frames, so its sound stops as well.
    document.addEventListener("visibilitychange", () => this.rest(), { signal });
    // Web Audio requires an interaction first.
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

  /** Release all resources until they are needed again. */
  release(): void {
    this.close();
    this.spatial.close();
    this.audio = null;
  }

  /** True if the reel has sound that can be played. */
  get available(): boolean {
    return !this.error && Boolean(this.manifest?.presentation.sound);
  }

  /** True if the sound has a position in the scene. */
  get placed(): boolean {
    return this.available && this.manifest!.presentation.sound!.position !== null;
  }

  get volume(): number {
    return this.loudness;
  }

  /** Throws `IndexSizeError` outside of 0 to 1, as in HTMLMediaElement. */
  set volume(given: number) {
    const volume = Number(given);
    if (!(volume >= 0 && volume <= 1))
      throw new DOMException(`The volume is ${volume}, not within 0 and 1.`, "IndexSizeError");
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

  /** Mute or unmute. A volume of 0 becomes 1. */
  toggle(): void {
    if (this.loudness > 0) this.muted = !this.silenced;
    else [this.volume, this.muted] = [1, false];
  }

  /** Reason for a delay, to show to people; null if there is none. */
  get trouble(): string | null {
    return this.source?.trouble ?? null;
  }

  /** Request permission to play sound. Call it within the interaction that started playback. optional: play muted if not allowed. */
  ask(optional = this.optional): void {
    this.optional = optional;
    const audio = this.heard(1) ? this.prepare() : null;
    if (!audio?.paused) return;
    this.startSpatialSound();
    this.start(audio);
    audio.pause();
  }

  /** Seek with the video. */
  seek(): void {
    this.moved = true;
  }

  /** Pause the sound. */
  rest(): void {
    if (this.audio && !this.audio.paused) this.audio.pause();
  }

  /** Playing has to wait for sound at this time. */
  isLate({ seconds, rate }: PictureTime): boolean {
    return this.heard(rate) && this.covers(seconds) && !this.source?.has(seconds);
  }

  /** Get what is heard at this time and, once there are pictures, after it. */
  want({ seconds, rate, loop, earliest, live }: PictureTime, pictures: boolean): void {
    if (this.heard(rate) && this.prepare())
      this.source!.want(seconds, pictures ? AHEAD : TAIL, loop && !live ? earliest : null);
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
    // Playing an ended element would restart it.
    if (!this.covers(seconds) || (audio.ended && !this.moved)) {
      if (!this.within(seconds)) this.moved = true;
      return passed;
    }
    const latency = (this.spatial.latency - shown) * rate - (rate === 1 ? 0 : STRETCH_LEAD);
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

  /** Return true if sound should be audible at a rate. */
  private heard(rate: number): boolean {
    return this.available && !this.silenced && this.loudness > 0 && rate >= SLOWEST;
  }

  private within(seconds: number): boolean {
    return segmentAt(this.manifest!.presentation.sound!.segments, seconds) >= 0;
  }

  /** Return true if there is sound at a time for which the video should wait. */
  private covers(seconds: number): boolean {
    const last = this.manifest!.presentation.sound!.segments.at(-1);
    return last !== undefined && seconds < last.start + last.seconds - TAIL && this.within(seconds);
  }

  /** Return the audio element with its source; null if the browser cannot play it. */
  private prepare(): HTMLAudioElement | null {
    const { reel } = this;
    this.audio ??= this.make();
    if (!this.source) {
      const failed = (error: unknown): void => {
        this.error = error instanceof Error ? error : new Error(messageOf(error));
        console.warn(this.error.message); // for the author of the reel; viewers see a short message
        this.rest();
        this.emit("volumechange");
      };
      try {
        this.source = new SoundSource(this.audio, reel!, {
          progress: () => this.emit("progress"),
          renewed: () => this.seek(),
          failed,
        });
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
