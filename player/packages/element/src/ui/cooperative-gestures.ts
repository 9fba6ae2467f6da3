/** Cooperative gestures, as on maps: in a scrolling page, wheel and one finger scroll the page until people click the picture. */
import type { Words } from "../base/words";
import type { HostWithStates } from "./host-states";
import { elementOf } from "./markup";

/** Milliseconds for which the hint is shown. */
const HINT = 1400;

/** Values of the attribute `gestures`. The default is "cooperative" in scrolling pages and frames. */
type Mode = "cooperative" | "greedy";

/** Decides whether a gesture belongs to the picture or the page. */
export class CooperativeGestures {
  readonly hint = elementOf(`<div class="gestures" aria-hidden="true"><p></p></div>`);
  private chosen = false;
  private timer = 0;

  /** canvas: canvas of the host element. words: returns the texts in its language. */
  constructor(
    private readonly host: HostWithStates,
    private readonly canvas: HTMLElement,
    private readonly words: () => Words,
    signal: AbortSignal,
  ) {
    const release = (): void => this.choose(false);
    const outside = (event: Event): void => void (event.composedPath().includes(host) || release());
    canvas.addEventListener("click", () => this.choose(true), { signal });
    document.addEventListener("pointerdown", outside, { capture: true, signal });
    host.addEventListener("focusout", (event) => event.relatedTarget && release(), { signal });
    host.addEventListener("keydown", (event) => event.key === "Escape" && release(), { signal });
    addEventListener("blur", release, { signal });
    this.watchTouches(signal);
    this.watchPage(signal);
    this.update();
  }

  /** True if one finger and the wheel move the picture instead of the page. */
  get active(): boolean {
    return (
      this.chosen || this.mode === "greedy" || document.fullscreenElement !== null || this.host.states.has("filling")
    );
  }

  /** Return true if a wheel event belongs to the picture. Otherwise show a hint. */
  takesWheel({ ctrlKey, metaKey }: WheelEvent): boolean {
    if (ctrlKey || metaKey || this.active) return true;
    this.explain(this.words()("Use {0} + scroll to zoom", /Mac|iP/.test(navigator.platform) ? "⌘" : "Ctrl"));
    return false;
  }

  private get mode(): Mode {
    const asked = this.host.getAttribute("gestures");
    if (asked === "cooperative" || asked === "greedy") return asked;
    return window !== top || isInScrollingPage(this.host) ? "cooperative" : "greedy";
  }

  private choose(chosen: boolean): void {
    this.chosen = chosen;
    if (chosen) this.hint.classList.remove("shown");
    this.update();
  }

  /** Set the touch-action, which browsers read when a finger touches the screen. */
  private update(): void {
    this.canvas.classList.toggle("shared", !this.active);
  }

  /** Reserve two fingers for the picture, and show a hint when the page takes one. */
  private watchTouches(signal: AbortSignal): void {
    const { canvas } = this;
    const keep = (event: TouchEvent): void => {
      if (event.targetTouches.length > 1 && event.cancelable) event.preventDefault();
    };
    for (const name of ["touchstart", "touchmove"] as const)
      canvas.addEventListener(name, keep, { passive: false, signal });
    canvas.addEventListener(
      "pointercancel",
      ({ pointerType }) => {
        if (pointerType === "touch" && !this.active) this.explain(this.words()("Use two fingers to move the view"));
      },
      { signal },
    );
  }

  /** Update when the size of the page or an attribute changes. */
  private watchPage(signal: AbortSignal): void {
    const update = (): void => this.update();
    const size = new ResizeObserver(update);
    const attributes = new MutationObserver(update);
    size.observe(document.documentElement);
    size.observe(this.host);
    attributes.observe(this.host, { attributeFilter: ["gestures", "class"] });
    document.addEventListener("fullscreenchange", update, { signal });
    this.canvas.addEventListener("pointerup", update, { signal });
    signal.addEventListener("abort", () => {
      size.disconnect();
      attributes.disconnect();
    });
  }

  private explain(words: string): void {
    this.hint.firstElementChild!.textContent = words;
    this.hint.classList.add("shown");
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.hint.classList.remove("shown"), HINT);
  }
}

/** Return true if the page or an ancestor scrolls. */
function isInScrollingPage(element: HTMLElement): boolean {
  const root = document.documentElement;
  for (let at = around(element); at && at !== root; at = around(at)) {
    if (at !== document.body && scrolls(at)) return true;
  }
  const hides = [root, document.body].some((box) => /hidden|clip/.test(getComputedStyle(box).overflowY));
  return !hides && root.scrollHeight > innerHeight + 1;
}

function scrolls(box: HTMLElement): boolean {
  const { overflowX, overflowY } = getComputedStyle(box);
  const may = (overflow: string): boolean => /auto|scroll/.test(overflow);
  return (
    (may(overflowY) && box.scrollHeight > box.clientHeight + 1) ||
    (may(overflowX) && box.scrollWidth > box.clientWidth + 1)
  );
}

function around(element: HTMLElement): HTMLElement | null {
  const root = element.getRootNode();
  return element.parentElement ?? (root instanceof ShadowRoot ? (root.host as HTMLElement) : null);
}
