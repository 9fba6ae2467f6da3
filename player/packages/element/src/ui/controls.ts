/** The controls over the picture: bar, messages and keys, and the actions of keys and buttons. */
import type { HostWithStates } from "./host-states";
import type { Player } from "../player/player";
import { messageOf } from "@splatreel/decoder/internal";
import { loadPart, playerAddress } from "@splatreel/renderer";
import type { Headset } from "../player/headset";
import { type HeadsetMode, supportsHeadset } from "../player/headset-support";
import { directionOf, LACKING } from "../base/words";
import { Bar } from "./bar";
import { type Actions, attachKeys, type KeyTable } from "./keys";
import { elementOf } from "./markup";
import { Messages } from "./messages";
import type { Panels } from "./panels";
import type { PathHost } from "./path-panel";
import { placeIn } from "./pointer-controls";

/** Fullscreen state of one element. */
class Fullscreen {
  /** changed: called when the state changes. */
  constructor(
    private readonly host: HostWithStates,
    private readonly changed: () => void,
    signal: AbortSignal,
  ) {
    document.addEventListener("fullscreenchange", changed, { signal });
  }

  get on(): boolean {
    return document.fullscreenElement !== null || this.host.states.has("filling");
  }

  /** Label of the button; "" if it would have no effect. */
  get offer(): string {
    if (document.fullscreenElement) return "Leave fullscreen";
    if (document.fullscreenEnabled) return "Fullscreen";
    if (this.on) return "Exit full window";
    const { clientWidth, clientHeight } = this.host;
    return clientWidth < innerWidth - 1 || clientHeight < innerHeight - 1 ? "Fill the window" : "";
  }

  /** Rejects where the browser refuses. */
  async toggle(): Promise<void> {
    if (document.fullscreenElement) await document.exitFullscreen();
    else if (document.fullscreenEnabled) await this.host.requestFullscreen();
    else if (this.offer) this.host.states.toggle("filling");
    this.changed();
  }

  /** Give the window back. Returns false if the element does not fill it. */
  leave(): boolean {
    if (!this.host.states.has("filling")) return false;
    this.host.states.toggle("filling", false);
    this.changed();
    return true;
  }
}

/** Milliseconds after which a press is a hold, and pixels above which it is a drag. */
const HOLD = 500;
const DRAG = 8;

/** Follow presses of a surface until the signal. changed: called when the speed rises, and when it is as before. */
export function attachHoldSpeed(
  surface: HTMLElement,
  player: Player,
  changed: (fast: boolean) => void,
  signal: AbortSignal,
): void {
  let press: { x: number; y: number; timer: number } | null = null;
  let before: number | null = null;
  const end = (): void => {
    if (press) clearTimeout(press.timer);
    press = null;
    if (before === null) return;
    player.playbackRate = before;
    before = null;
    changed(false);
  };
  const begin = (): void => {
    if (player.paused || player.playback.callerDraws) return;
    before = player.playbackRate;
    player.playbackRate = 2 * before;
    changed(true);
  };
  surface.addEventListener(
    "pointerdown",
    ({ clientX: x, clientY: y, button, shiftKey, isPrimary }) => {
      end();
      if (button === 0 && !shiftKey && isPrimary) press = { x, y, timer: window.setTimeout(begin, HOLD) };
    },
    { signal },
  );
  surface.addEventListener(
    "pointermove",
    ({ clientX, clientY }) => {
      if (press && before === null && Math.hypot(clientX - press.x, clientY - press.y) > DRAG) end();
    },
    { signal },
  );
  for (const name of ["pointerup", "pointercancel"]) surface.addEventListener(name, end, { signal });
  for (const name of ["pause", "emptied"]) player.addEventListener(name, end, { signal });
  signal.addEventListener("abort", end);
}

/** Milliseconds without a move after which the controls fade during playback. */
const FADE_AFTER = 2600;

/** Sets and clears the state `idle` of the host. */
class AutoHide {
  private fade = 0;
  private touched = false;

  /** holder: element of all controls. busy: returns true while they are in use. */
  constructor(
    private readonly host: HostWithStates,
    private readonly holder: HTMLElement,
    private readonly player: Player,
    private readonly busy: () => boolean,
    signal: AbortSignal,
  ) {
    const { canvas } = player;
    for (const name of ["pointermove", "pointerdown"] as const)
      host.addEventListener(name, (event) => this.pointer(event), { signal });
    // Ignore focus by click or tap.
    host.addEventListener(
      "focusin",
      (event) => (event.composedPath()[0] as Element).matches(":focus-visible") && this.wake(),
      { signal },
    );
    host.addEventListener("pointerleave", (event) => event.pointerType !== "touch" && this.sleep(), { signal });
    // The click follows the tap, so that it does not reach the controls that it shows.
    canvas.addEventListener("click", () => this.touched && (this.asleep ? this.wake() : this.sleep()), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.fade));
  }

  /** Keep the controls visible while paused. */
  update(): void {
    const { paused, error } = this.player;
    if (paused || error) this.host.states.toggle("idle", false);
    else if (!this.fade) this.wake();
  }

  /** Show the controls for a while. */
  wake(): void {
    this.host.states.toggle("idle", false);
    clearTimeout(this.fade);
    this.fade = window.setTimeout(() => this.sleep(), FADE_AFTER);
  }

  private get asleep(): boolean {
    return this.host.states.has("idle");
  }

  private pointer(event: PointerEvent): void {
    this.touched = event.pointerType === "touch";
    if (!this.touched || event.composedPath().includes(this.holder)) this.wake();
  }

  private sleep(): void {
    const { player, holder, host } = this;
    if (player.paused || player.error || this.busy() || holder.matches(":has(:focus-visible)")) return;
    // Hidden controls must not keep the focus.
    if (holder.matches(":has(.bar :focus)")) player.canvas.focus({ preventScroll: true });
    host.states.toggle("idle", true);
  }
}

/** What the entry needs of the controls. */
interface EntryOptions {
  /** Return the button of a mode. */
  button(mode: HeadsetMode): HTMLElement;
  /** Show an English text for some seconds. */
  say(words: string): void;
  /** Called before a headset shows the reel. */
  begins(): void;
  /** Called when `presenting` has changed. */
  changed(): void;
}

/** Enters and leaves the headset of one player. */
class HeadsetEntry {
  /** What the headset shows; null for nothing. */
  presenting: HeadsetMode | null = null;
  private headset: Headset | null = null;

  constructor(
    private readonly player: Player,
    private readonly options: EntryOptions,
  ) {
    for (const mode of ["vr", "ar"] as const)
      void supportsHeadset(mode).then((there) => (options.button(mode).hidden = !there));
  }

  /** Leave the headset. */
  leave(): void {
    this.headset?.leave();
  }

  /** Enter a mode, or leave the headset. Returns false if there is none. */
  toggle(mode: HeadsetMode): boolean {
    const { options, headset } = this;
    headset?.leave();
    if (headset) return true;
    if (options.button(mode).hidden) return false;
    options.begins();
    this.enter(mode).catch((error) => {
      console.warn(`Immersive ${mode} cannot start: ${messageOf(error)}`); // browsers word it for developers
      options.say(
        mode === "vr"
          ? "The headset cannot be used. Connect it, and let this page use it."
          : "Augmented reality cannot start. Let this page use the camera.",
      );
    });
    return true;
  }

  private async enter(mode: HeadsetMode): Promise<void> {
    const { player, options } = this;
    const { Headset } = await loadPart("headset.js", () => import("../player/headset"));
    if (mode === "ar") options.say("Look at the floor and tap to place the reel");
    this.headset = await Headset.enter(player, mode, () => {
      this.headset = this.presenting = null;
      options.changed();
    });
    this.presenting = mode;
    options.changed();
  }
}

/** Events of the player after which the controls are updated. */
const EVENTS = (
  "emptied loadstart loadedmetadata durationchange canplay play pause timeupdate progress waiting " +
  "playing seeking seeked ratechange volumechange trackchange sectionchange ended deferred error"
).split(" ");

/** Step of the volume by a key, and pixels within which a right click stays. */
const VOLUME = 0.05;
const CLICK = 6;

/** Creates the controls of one element. */
export class Controls {
  private readonly holder = elementOf(`<div class="ui"></div>`);
  private readonly messages: Messages;
  private readonly bar: Bar;
  private readonly full: Fullscreen;
  private readonly idle: AutoHide;
  private readonly headset: HeadsetEntry;
  private readonly keys: KeyTable;
  private readonly actions: Actions;
  private readonly life = new AbortController();
  /** Null until one of them is needed. */
  private panels: Panels | null = null;

  constructor(
    private readonly host: PathHost & HostWithStates & { readonly link: string },
    private readonly root: ShadowRoot,
    private readonly player: Player,
  ) {
    const { signal } = this.life;
    const actions = (this.actions = this.actionsOf(player));
    this.messages = new Messages(player);
    this.bar = new Bar(player, {
      play: actions.toggle,
      reset: actions.reset,
      captions: () => player.tracks?.toggle(),
      settings: () => this.use((panels) => panels.toggleMenu()),
      headset: actions.headset,
      ar: () => this.headset.toggle("ar"),
      full: actions.fullscreen,
    });
    this.headset = new HeadsetEntry(player, {
      button: (mode) => this.bar.button(mode === "vr" ? "headset" : "ar"),
      say: (words) => this.say(words),
      begins: () => this.panels?.endWalk(),
      changed: () => this.update(),
    });
    this.full = new Fullscreen(host, () => this.update(), signal);
    this.holder.append(this.messages.box, this.bar.box);
    [this.holder.lang, this.holder.dir] = [player.language, directionOf(player.language)];
    root.append(this.holder);
    // On the bundled page keys work wherever the focus is.
    const keyboard = host.closest("[data-splatreel-page]") ? document.documentElement : host;
    this.keys = attachKeys(keyboard, player, actions, signal);
    const inUse = (): boolean => this.bar.seek.dragging || this.panels?.open === true;
    this.idle = new AutoHide(host, this.holder, player, inUse, signal);
    keyboard.addEventListener("keydown", () => this.idle.wake(), { signal });
    for (const name of EVENTS) player.addEventListener(name, () => this.update(), { signal });
    player.canvas.addEventListener("pointerdown", () => this.panels?.openMenu(false), { signal });
    this.watchRightClicks();
    attachHoldSpeed(player.canvas, player, (fast) => this.say(fast ? `${player.playbackRate} ×` : ""), signal);
    this.update();
  }

  /** Show an English text for some seconds, in the language of the player. */
  say(words: string): void {
    this.messages.say(this.player.words(words));
  }

  /** Remove the controls. */
  remove(): void {
    this.life.abort();
    this.headset.leave();
    this.holder.remove();
  }

  /** Return the actions of keys, buttons and the menu. */
  private actionsOf(player: Player): Actions {
    const panel = (act: (panels: Panels) => void) => () => void this.use(act);
    return {
      toggle: () => {
        if (!player.hasSource || player.error) return false;
        if (player.paused) player.play();
        else player.pause();
        return true;
      },
      fullscreen: () => void this.full.toggle().catch(() => this.say("The browser does not allow fullscreen")),
      headset: () => this.headset.toggle("vr"),
      reset: () => player.camera?.reset(),
      fly: () => {
        player.camera?.fly(!player.camera.flying);
        this.panels?.update();
      },
      walk: panel((panels) => panels.toggleWalk()),
      section: panel((panels) => panels.stepSection()),
      volume: (steps) => this.changeVolume(steps),
      context: panel((panels) => panels.openContext(null)),
      statistics: panel((panels) => panels.toggleStatistics()),
      picture: panel((panels) => void panels.saveScreenshot()),
      help: panel((panels) => panels.toggleHelp()),
      escape: () => this.panels?.closeTop() === true || this.full.leave(),
    };
  }

  /** Load the panels and use them, unless the controls are gone by then. */
  private async use(act: (panels: Panels) => void): Promise<void> {
    if (this.panels) return act(this.panels);
    const {
      host,
      root,
      player,
      holder,
      keys,
      actions,
      life: { signal },
    } = this;
    try {
      const { Panels } = await loadPart("panels.js", () => import("./panels"));
      if (signal.aborted) return;
      this.panels ??= new Panels({
        host,
        root,
        player,
        holder,
        keys,
        actions,
        signal,
        settings: this.bar.button("settings"),
        address: playerAddress(),
        say: (words) => this.say(words),
        toast: (text) => this.messages.say(text),
      });
      act(this.panels);
    } catch {
      this.say(LACKING);
    }
  }

  /** Open the context menu at a right click. A right drag pans. */
  private watchRightClicks(): void {
    const {
      player: { canvas },
      life: { signal },
    } = this;
    let pressed = [0, 0];
    canvas.addEventListener("pointerdown", ({ clientX, clientY }) => (pressed = [clientX, clientY]), { signal });
    canvas.addEventListener(
      "pointerup",
      (event) => {
        const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
        const place = placeIn(canvas, event);
        if (event.button === 2 && event.pointerType === "mouse" && moved < CLICK)
          void this.use((panels) => panels.openContext(place));
      },
      { signal },
    );
  }

  private changeVolume(steps: number): void {
    const { player } = this;
    const { muted, volume } = player;
    // A muted reel first gets the volume back that it had. It stays muted when people turn it down.
    const next = muted && volume > 0 ? volume : Math.min(Math.max(volume + steps * VOLUME, 0), 1);
    if (!muted || steps > 0) [player.volume, player.muted] = [next, false];
    this.messages.say(player.words("Volume {0} %", player.muted ? 0 : Math.round(100 * next)));
  }

  private update(): void {
    const { bar, full, headset } = this;
    bar.update({ full: full.on, fullLabel: full.offer, presenting: headset.presenting });
    this.messages.update();
    this.panels?.update();
    this.idle.update();
  }
}
