/** Starts and stops the player of an element by its visibility. */
import type { Player } from "../player/player";
import type { Poster } from "./poster";

/** Maximum number of devices, to leave some to the rest of the page. */
const MAX_DEVICES = 12;

/** An element that may hold a device. */
export interface ContextHolder {
  /** True if it may release its device unnoticed, since its image is static. */
  readonly idle: boolean;
  /** True if it must keep its device. */
  readonly needed: boolean;
  /** Acquire a device. */
  wake(): void;
  /** Release the device. */
  rest(): void;
}

/** Grants devices in order of requests, and takes them from idle holders. */
export class ContextPool {
  private readonly holding: ContextHolder[] = [];
  /** Holders that wait for a device, in order, and those that lost theirs. */
  private waiting: ContextHolder[] = [];
  private evicted: ContextHolder[] = [];

  constructor(private readonly most = MAX_DEVICES) {}

  /** Request a device. now: people interact with the holder, so that it takes precedence. */
  claim(holder: ContextHolder, now = false): void {
    const at = this.holding.indexOf(holder);
    if (at >= 0) return void this.holding.push(...this.holding.splice(at, 1)); // most recently used
    this.forget(holder);
    const victim =
      now && this.holding.length >= this.most ? (this.victim() ?? this.holding.find(({ needed }) => !needed)) : null;
    if (victim) this.evict(victim);
    if (now) this.waiting.unshift(holder);
    else this.waiting.push(holder);
    this.review();
  }

  /** Withdraw from the pool. */
  leave(holder: ContextHolder): void {
    this.forget(holder);
    const at = this.holding.indexOf(holder);
    if (at < 0) return;
    this.holding.splice(at, 1);
    holder.rest();
    this.review();
  }

  /** Grant devices again, after a holder became idle. */
  review(): void {
    while (this.waiting.length > 0 && (this.holding.length < this.most || this.victim())) {
      if (this.holding.length >= this.most) this.evict(this.victim()!);
      this.grant(this.waiting.shift()!);
    }
    while (this.evicted.length > 0 && this.holding.length < this.most) this.grant(this.evicted.pop()!);
  }

  private victim(): ContextHolder | undefined {
    return this.holding.find((holder) => holder.idle);
  }

  private grant(holder: ContextHolder): void {
    this.holding.push(holder);
    holder.wake();
  }

  private evict(holder: ContextHolder): void {
    this.holding.splice(this.holding.indexOf(holder), 1);
    this.evicted.push(holder);
    holder.rest();
  }

  private forget(holder: ContextHolder): void {
    this.waiting = this.waiting.filter((other) => other !== holder);
    this.evicted = this.evicted.filter((other) => other !== holder);
  }
}

/** Margin around the window, relative to its size, in which elements prepare to play. */
const NEAR = "75% 25%";
/** Milliseconds until an element outside of the margin releases its resources. */
const LINGER = 4000;

/** Graphics devices of the page, shared by all elements. */
const devices = new ContextPool();

/** Visibility of one element. */
export class Visibility implements ContextHolder {
  private connected = false;
  private seen = false;
  private near = false;
  /** Number of images being rendered, during which the player stays awake. */
  private pictures = 0;
  private timer = 0;
  /** True after an interaction, or with preload="auto". */
  private asked = true;
  /** True if not even the manifest is downloaded before an interaction. */
  private patient = false;

  constructor(
    private readonly element: Element,
    private readonly player: Player,
    private readonly poster: Poster,
  ) {
    for (const event of ["canplay", "pause", "error"]) player.addEventListener(event, () => devices.review());
    for (const event of ["play", "seeking"]) player.addEventListener(event, () => this.ask());
  }

  get idle(): boolean {
    const { playback, paused, error } = this.player;
    return !this.needed && (error !== null || (playback.ready && (paused || !this.seen)));
  }

  get needed(): boolean {
    return this.pictures > 0;
  }

  wake(): void {
    this.player.wake();
  }

  rest(): void {
    this.poster.keep();
    this.player.rest();
  }

  /** Observe the element until the signal. eager: treat it as near. */
  watch(eager: boolean, signal: AbortSignal): void {
    [this.connected, this.seen, this.near] = [true, isOnScreen(this.element), eager || isOnScreen(this.element)];
    const watch = (act: (on: boolean) => void, options: IntersectionObserverInit): void => {
      const observer = new IntersectionObserver((entries) => act(entries.at(-1)!.isIntersecting), options);
      observer.observe(this.element);
      signal.addEventListener("abort", () => observer.disconnect());
    };
    watch((on) => ((this.seen = on), this.settle()), {});
    if (!eager) watch((on) => this.approach(on), { rootMargin: NEAR });
    signal.addEventListener("abort", () => {
      clearTimeout(this.timer);
      this.connected = false;
      this.settle();
    });
    this.settle();
  }

  /** Set what to download before an interaction: "auto", "metadata" or "none". again: a new reel, which needs a new interaction. */
  prefer(preload: string, again: boolean): void {
    if (again) this.asked = false;
    this.asked ||= preload === "auto";
    this.patient = preload === "none";
    this.player.deferred = !this.asked;
    this.settle();
  }

  /** Record an interaction that asks for playback. */
  ask(): void {
    if (this.asked) return;
    this.asked = true;
    this.player.deferred = false;
    this.settle();
  }

  /** Request a graphics device with precedence, since people interact with the element or a page plays it. */
  interact(): void {
    if (this.wanted) devices.claim(this, true);
  }

  /** Keep the player awake during `work`. */
  async keepAwake<T>(work: () => Promise<T>): Promise<T> {
    this.pictures++;
    this.ask();
    this.settle();
    try {
      return await work();
    } finally {
      this.pictures--;
      this.settle();
      devices.review();
    }
  }

  /** Apply the present visibility to the player. */
  settle(): void {
    this.player.show(this.connected && (this.seen || this.pictures > 0));
    if (this.wanted) devices.claim(this, this.needed);
    else devices.leave(this);
  }

  private get wanted(): boolean {
    return this.connected && this.player.hasSource && (this.asked || !this.patient) && (this.near || this.pictures > 0);
  }

  private approach(near: boolean): void {
    clearTimeout(this.timer);
    const take = (): void => {
      this.near = near;
      this.settle();
    };
    if (near) take();
    else this.timer = window.setTimeout(take, LINGER);
  }
}

/** Return true if an element is on screen now, since observers report only after the next frame. */
function isOnScreen(element: Element): boolean {
  const { top, bottom, left, right } = element.getBoundingClientRect();
  return bottom > top && right > left && bottom > 0 && right > 0 && top < innerHeight && left < innerWidth;
}
