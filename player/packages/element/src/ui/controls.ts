/** The controls over the picture: bar, menu, help, statistics and messages, and the actions of keys and buttons. */
import { isReelError, messageOf, type Presentation } from "@splatreel/decoder/internal";
import { directionOf } from "../base/words";
import { loadPart, playerAddress } from "@splatreel/renderer";
import type { Headset } from "../player/headset";
import { supportsHeadset, type HeadsetMode } from "../player/headset-support";
import type { Player } from "../player/player";
import { AutoHide } from "./auto-hide";
import { Bar } from "./bar";
import type { Dialog } from "./dialog";
import { Fullscreen } from "./fullscreen";
import { attachHoldSpeed } from "./hold-speed";
import type { HostWithStates } from "./host-states";
import { attachKeys, type KeyTable } from "./keys";
import { elementOf } from "./markup";
import type { Menu, MenuState } from "./menu";
import { Messages } from "./messages";
import type { PathHost } from "./path-panel";

/** Events of the player after which the controls are updated. */
const EVENTS = ["emptied", "loadstart", "loadedmetadata", "durationchange", "canplay", "play", "pause", "timeupdate", "progress", "waiting", "playing"];
EVENTS.push("seeking", "seeked", "ratechange", "volumechange", "trackchange", "sectionchange", "ended", "deferred", "error");

/** English title of the help. */
const HELP = "Keys and gestures";
/** Step of the volume by a key, and pixels within which a right click stays. */
const VOLUME = 0.05;
const CLICK = 6;
/** Message if a part of the player cannot be loaded. */
export const LACKING = "This part of the player cannot be loaded";

/** Creates the controls of one element. */
export class Controls {
  private readonly holder = elementOf(`<div class="ui"></div>`);
  private readonly statistics: HTMLElement;
  private readonly messages: Messages;
  private readonly bar: Bar;
  private readonly full: Fullscreen;
  private readonly idle: AutoHide;
  private readonly keys: KeyTable;
  private readonly life = new AbortController();
  private headset: Headset | null = null;
  private presenting: HeadsetMode | null = null;
  private menu: Menu | null = null;
  private dialog: Dialog | null = null;
  private describe: typeof import("./statistics").describe | null = null;
  private path: { close(): void } | null = null;
  private walk: { close(): void } | null = null;
  private editing: { close(): void } | null = null;

  constructor(private readonly host: PathHost & HostWithStates & { readonly link: string }, private readonly root: ShadowRoot, private readonly player: Player) {
    const { signal } = this.life;
    const actions = this.actions();
    this.statistics = elementOf(`<dl class="sheet stats" aria-label="Statistics" hidden></dl>`, player.words);
    this.messages = new Messages(player);
    this.bar = new Bar(player, {
      play: actions.toggle,
      reset: actions.reset,
      captions: () => player.tracks?.toggle(),
      settings: () => this.openMenu(!this.menu?.open),
      headset: actions.headset,
      ar: () => this.toggleHeadset("ar"),
      full: actions.fullscreen,
    });
    this.full = new Fullscreen(host, () => this.update(), signal);
    this.holder.append(this.messages.box, this.statistics, this.bar.box);
    [this.holder.lang, this.holder.dir] = [player.language, directionOf(player.language)];
    root.append(this.holder);
    // On the bundled page keys work wherever the focus is.
    const keyboard = host.closest("[data-splatreel-page]") ? document.documentElement : host;
    this.keys = attachKeys(keyboard, player, actions, signal);
    this.idle = new AutoHide(host, this.holder, player, () => this.bar.seek.dragging || this.menu?.open === true || !!this.dialog?.open, signal);
    keyboard.addEventListener("keydown", () => this.idle.wake(), { signal });
    this.listen();
    this.update();
  }

  /** Show an English text for some seconds, in the language of the player. */
  say(words: string): void {
    this.messages.say(this.player.words(words));
  }

  /** Remove the controls. */
  remove(): void {
    this.life.abort();
    this.headset?.leave();
    this.walk?.close();
    this.path?.close();
    this.editing?.close();
    this.holder.remove();
  }

  /** Return the actions of keys, buttons and the menu. */
  private actions() {
    const { player } = this;
    return {
      toggle: () => (player.paused ? player.play() : player.pause()),
      fullscreen: () => void this.full.toggle().catch(() => this.say("The browser does not allow fullscreen")),
      headset: () => this.toggleHeadset("vr"),
      reset: () => player.camera?.reset(),
      fly: () => this.fly(),
      walk: () => this.toggleWalk(),
      section: () => this.stepSection(),
      volume: (steps: number) => this.changeVolume(steps),
      context: () => this.openContext(null),
      statistics: () => this.toggleStatistics(),
      picture: () => void this.saveScreenshot(),
      help: () => (this.dialog?.open === player.words(HELP) ? this.dialog.close() : void this.help()),
      escape: () => this.closeSheets(),
    };
  }

  private listen(): void {
    const { player, life: { signal } } = this;
    for (const name of EVENTS) player.addEventListener(name, () => this.update(), { signal });
    player.canvas.addEventListener("pointerdown", () => this.openMenu(false), { signal });
    this.watchRightClicks();
    attachHoldSpeed(player.canvas, player, (fast) => this.say(fast ? `${player.playbackRate} ×` : ""), signal);
    for (const mode of ["vr", "ar"] as const) void supportsHeadset(mode).then((there) => (this.headsetButton(mode).hidden = !there));
    const timer = setInterval(() => this.showStatistics(), 250);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  private headsetButton(mode: HeadsetMode): HTMLElement {
    return this.bar.button(mode === "vr" ? "headset" : "ar");
  }

  private toggleHeadset(mode: HeadsetMode): void {
    if (this.headset) return this.headset.leave();
    if (this.headsetButton(mode).hidden) return;
    const { player } = this;
    this.walk?.close();
    const ended = (): void => {
      this.headset = this.presenting = null;
      this.update();
    };
    const enter = async (): Promise<void> => {
      const { Headset } = await loadPart("headset.js", () => import("../player/headset"));
      if (mode === "ar") this.say("Look at the floor and tap to place the reel");
      this.headset = await Headset.enter(player, mode, ended);
      this.presenting = mode;
      this.update();
    };
    enter().catch((error) => {
      console.warn(`Immersive ${mode} cannot start: ${messageOf(error)}`); // browsers word it for developers
      this.say(mode === "vr" ? "The headset cannot be used. Connect it, and let this page use it." : "Augmented reality cannot start. Let this page use the camera.");
    });
  }

  private async saveScreenshot(): Promise<void> {
    try {
      const { saveScreenshot } = await loadPart("screenshot.js", () => import("./screenshot"));
      await saveScreenshot(this.player);
    } catch (error) {
      console.warn(`The picture cannot be saved: ${messageOf(error)}`);
      this.say(isReelError(error) ? error.plain : "The picture cannot be saved");
    }
  }

  /** Open the context menu at a right click. A right drag pans. */
  private watchRightClicks(): void {
    const { player: { canvas }, life: { signal } } = this;
    let pressed = [0, 0];
    canvas.addEventListener("pointerdown", ({ clientX, clientY }) => (pressed = [clientX, clientY]), { signal });
    canvas.addEventListener("pointerup", ({ button, clientX, clientY, pointerType }) => {
      if (button === 2 && pointerType === "mouse" && Math.hypot(clientX - pressed[0], clientY - pressed[1]) < CLICK) this.openContext([clientX, clientY]);
    }, { signal });
  }

  /** Open the context menu at a position of the window; null for the middle of the picture. */
  private openContext(at: [number, number] | null): void {
    const { host, player } = this;
    if (!player.manifest) return;
    const { left, top, width, height } = player.canvas.getBoundingClientRect();
    const place: [number, number] = at ? [at[0] - left, at[1] - top] : [width / 2, height / 2];
    const actions = {
      link: host.hasAttribute("share") && !player.manifest.files ? host.link : null,
      say: (words: string) => this.say(words),
      share: () => this.share(),
      section: () => this.stepSection(),
      walk: () => this.toggleWalk(),
      statistics: () => this.toggleStatistics(),
      about: hasTexts(player.manifest.presentation) ? () => this.about() : null,
      help: () => void this.help(),
    };
    void this.withPart(loadPart("context-menu.js", () => import("./context-menu")), ({ ContextMenu }) => new ContextMenu(this.root, this.holder, place, player, actions));
  }

  private stepSection(): void {
    void this.withPart(loadPart("section.js", () => import("./section")), ({ stepSection }) => stepSection(this.player, (words) => this.messages.say(words)));
  }

  private changeVolume(steps: number): void {
    const { soundtrack } = this.player;
    const { muted, volume } = soundtrack;
    // A muted reel first gets the volume back that it had. It stays muted when people turn it down.
    const next = muted && volume > 0 ? volume : Math.min(Math.max(volume + steps * VOLUME, 0), 1);
    if (!muted || steps > 0) [soundtrack.volume, soundtrack.muted] = [next, false];
    this.messages.say(this.player.words("Volume {0} %", soundtrack.muted ? 0 : Math.round(100 * next)));
  }

  private fly(): void {
    const { camera } = this.player;
    camera?.fly(!camera.flying);
    this.menu?.update();
  }

  /** Load a part of the player and use it, unless the controls are gone by then. */
  private async withPart<T>(loading: Promise<T>, use: (part: T) => void): Promise<void> {
    try {
      const part = await loading;
      if (!this.life.signal.aborted) use(part);
    } catch {
      this.say(LACKING);
    }
  }

  /** Begin or end a walk, whose part is loaded on demand. */
  private toggleWalk(): void {
    this.openMenu(false);
    if (this.walk) return this.walk.close();
    const { root, holder, player } = this;
    void this.withPart(loadPart("walk-mode.js", () => import("./walk-mode")), ({ WalkMode }) => {
      if (this.walk || !player.camera || player.presented) return;
      this.walk = new WalkMode(root, holder, player, (words) => this.say(words), () => (this.walk = null));
    });
  }

  private openPath(): void {
    this.openMenu(false);
    if (this.path) return this.path.close();
    void this.withPart(loadPart("path-panel.js", () => import("./path-panel")), ({ PathPanel }) => {
      if (this.path || !this.player.camera) return;
      this.path = new PathPanel(this.host, this.root, () => {
        this.path = null;
        this.player.canvas.focus();
      });
    });
  }

  /** Open the panel that makes an edit list, which is loaded on demand. */
  private openEdit(): void {
    this.openMenu(false);
    if (this.editing) return this.editing.close();
    void this.withPart(loadPart("edit-panel.js", () => import("./edit-panel")), ({ EditPanel }) => {
      if (this.editing || !this.player.camera) return;
      this.path?.close();
      this.editing = new EditPanel(this.player, this.root, () => {
        this.editing = null;
        this.player.canvas.focus();
      });
    });
  }

  private help(): Promise<void> {
    return this.withPart(loadPart("help.js", () => import("./help")), ({ helpOf }) => this.show(this.player.words(HELP), helpOf(this.root, this.keys, this.player.words)));
  }

  private toggleStatistics(): void {
    this.statistics.hidden = !this.statistics.hidden;
    this.menu?.update();
    void this.withPart(loadPart("statistics.js", () => import("./statistics")), ({ describe }) => {
      this.describe = describe;
      this.showStatistics();
    });
  }

  private showStatistics(): void {
    const { statistics, player: { stats, words } } = this;
    if (!statistics.hidden && stats && this.describe) statistics.replaceChildren(...elementOf(`<dl>${this.describe(stats).map(([name, value]) => `<dt>${words(name)}</dt><dd>${value}</dd>`).join("")}</dl>`).children);
  }

  private show(title: string, content: HTMLElement): void {
    this.openMenu(false);
    void this.withPart(loadPart("dialog.js", () => import("./dialog")), ({ Dialog }) => {
      const { root, player, holder, life: { signal } } = this;
      this.dialog ??= new Dialog(root, () => player.canvas.focus(), player.words, signal);
      holder.append(this.dialog.box);
      this.dialog.show(title, content);
    });
  }

  private about(): void {
    const { words, manifest } = this.player;
    const { presentation } = manifest!;
    void this.withPart(loadPart("about.js", () => import("./about")), ({ aboutOf }) => this.show(presentation.title || words("About this reel"), aboutOf(presentation, words)));
  }

  private share(): void {
    const { host, player: { manifest } } = this;
    this.openMenu(false);
    void this.withPart(loadPart("share.js", () => import("./share")), ({ shareOf }) => {
      const shared = { link: host.link, page: location.href.split("#")[0], reel: manifest!.url, player: playerAddress(), title: manifest!.presentation.title };
      this.show(this.player.words("Share"), shareOf(this.root, shared, this.player.words, (words) => this.say(words)));
    });
  }

  /** Close the open dialog or menu, or else leave fullscreen. */
  private closeSheets(): void {
    if (this.dialog?.open) this.dialog.close();
    else if (this.menu?.open) {
      this.openMenu(false);
      this.bar.button("settings").focus();
    } else if (this.walk) this.walk.close();
    else this.full.leave();
  }

  private openMenu(open: boolean): void {
    if (!this.menu) return void (open && this.createMenu());
    this.menu.open = open;
    this.bar.button("settings").setAttribute("aria-expanded", String(open));
  }

  /** Load and open the menu. */
  private createMenu(): void {
    const { host, root, player, holder } = this;
    const actions = { ...this.actions(), share: () => this.share(), about: () => this.about(), path: () => this.openPath(), edit: () => this.openEdit(), loop: (on: boolean) => void host.toggleAttribute("loop", on) };
    const state = (): MenuState => {
      const { manifest } = player;
      return { statistics: !this.statistics.hidden, shares: host.hasAttribute("share") && !!manifest && !manifest.files, describes: !!manifest && hasTexts(manifest.presentation) };
    };
    void this.withPart(loadPart("menu.js", () => import("./menu")), ({ Menu }) => {
      if (this.menu) return;
      this.menu = new Menu(root, player, actions, state);
      holder.append(this.menu.box);
      this.openMenu(true);
    });
  }

  private update(): void {
    this.bar.update({ full: this.full.on, fullLabel: this.full.offer, presenting: this.presenting });
    this.messages.update();
    this.menu?.update();
    this.idle.update();
  }
}

/** Return true if the reel has any such text. */
function hasTexts({ title, author, description, licence }: Presentation): boolean {
  return [title, author, description, licence].some((words) => words !== "");
}
