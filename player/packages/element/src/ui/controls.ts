/** The controls over the picture: bar, messages and keys, and the actions of keys and buttons. */
import { directionOf, LACKING } from "../base/words";
import { loadPart, playerAddress } from "@splatreel/renderer";
import type { Player } from "../player/player";
import { AutoHide } from "./auto-hide";
import { Bar } from "./bar";
import { Fullscreen } from "./fullscreen";
import { HeadsetEntry } from "./headset-entry";
import { attachHoldSpeed } from "./hold-speed";
import type { HostWithStates } from "./host-states";
import { type Actions, attachKeys, type KeyTable } from "./keys";
import { elementOf } from "./markup";
import { Messages } from "./messages";
import type { Panels } from "./panels";
import type { PathHost } from "./path-panel";
import { placeIn } from "./pointer-controls";

/** Events of the player after which the controls are updated. */
const EVENTS = [
  "emptied",
  "loadstart",
  "loadedmetadata",
  "durationchange",
  "canplay",
  "play",
  "pause",
  "timeupdate",
  "progress",
  "waiting",
  "playing",
];
EVENTS.push(
  "seeking",
  "seeked",
  "ratechange",
  "volumechange",
  "trackchange",
  "sectionchange",
  "ended",
  "deferred",
  "error",
);

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
