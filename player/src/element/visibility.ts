/** Whether people may see an element: a player draws while they do, and holds nothing where they do not. */
import type { Player } from "../player/player";
import { ContextPool, type ContextHolder } from "./context-pool";
import type { Poster } from "./poster";

/** How far beyond the window, in parts of its size, elements get ready. */
const NEAR = "75% 25%";
/** Milliseconds that an element is kept as it is after it has gone far away. */
const LINGER = 4000;

/** Those of this page, which all its elements share. */
const devices = new ContextPool();

export class Visibility implements ContextHolder {
  private connected = false;
  private seen = false;
  private near = false;
  /** Pictures that are being taken, whether people see them or not. */
  private pictures = 0;
  private timer = 0;
  /** Somebody has asked for pictures, or `preload` gets them unasked. */
  private asked = true;
  /** Until then not even the manifest is got. */
  private patient = false;

  constructor(private readonly element: Element, private readonly player: Player, private readonly poster: Poster) {
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

  /** Watch where the element is until the signal; eager: it is near wherever it is. */
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

  /** What to get of a reel before people ask for it: "auto", "metadata" or "none". again: they have not asked for the one that comes. */
  prefer(preload: string, again: boolean): void {
    if (again) this.asked = false;
    this.asked ||= preload === "auto";
    this.patient = preload === "none";
    this.player.deferred = !this.asked;
    this.settle();
  }

  /** Somebody asks for pictures. */
  ask(): void {
    if (this.asked) return;
    this.asked = true;
    this.player.deferred = false;
    this.settle();
  }

  /** Somebody's hand is on the element, or a page asks it to play. */
  interact(): void {
    if (this.wanted) devices.claim(this, true);
  }

  /** Have the player at work, seen or not, while a picture is taken. */
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

  /** Let the player be as is right where the element is. */
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

/** Observers answer after the next picture: what is on screen already need not wait for it. */
function isOnScreen(element: Element): boolean {
  const { top, bottom, left, right } = element.getBoundingClientRect();
  return bottom > top && right > left && bottom > 0 && right > 0 && top < innerHeight && left < innerWidth;
}
