/** The controls over the picture: bar, menu, help, statistics and messages, and the actions of keys and buttons. */
import { messageOf } from "../base/errors";
import { loadPart, playerAddress } from "../files/bundle";
import type { Headset } from "../player/headset";
import { hasHeadset } from "../player/headset-support";
import type { Player } from "../player/player";
import { describe } from "../player/stats";
import { aboutOf, hasTexts } from "./about";
import { AutoHide } from "./auto-hide";
import { Bar } from "./bar";
import { Dialog } from "./dialog";
import { Fullscreen } from "./fullscreen";
import { attachKeys, type KeyTable } from "./keys";
import { elementOf } from "./markup";
import { Menu } from "./menu";
import { Messages } from "./messages";
import type { PathHost } from "./path-panel";

/** Events of the player after which the controls are updated. */
const EVENTS = ["emptied", "loadstart", "loadedmetadata", "durationchange", "canplay", "play", "pause", "timeupdate", "progress", "waiting", "playing"];
EVENTS.push("seeking", "seeked", "ratechange", "volumechange", "trackchange", "ended", "deferred", "error");

const HELP = "Keys and gestures";
/** Message if a part of the player cannot be loaded. */
export const LACKING = "This part of the player cannot be loaded";

/** Creates the controls of one element. */
export class Controls {
  private readonly holder = elementOf(`<div class="ui"></div>`);
  private readonly statistics = elementOf(`<dl class="sheet stats" aria-label="Statistics" hidden></dl>`);
  private readonly messages: Messages;
  private readonly bar: Bar;
  private readonly menu: Menu;
  private readonly dialog: Dialog;
  private readonly full: Fullscreen;
  private readonly idle: AutoHide;
  private readonly keys: KeyTable;
  private readonly life = new AbortController();
  private headset: Headset | null = null;
  private path: { close(): void } | null = null;

  constructor(private readonly host: PathHost & { readonly link: string }, private readonly root: ShadowRoot, private readonly player: Player) {
    const { signal } = this.life;
    const actions = this.actions();
    this.messages = new Messages(player);
    this.bar = new Bar(player, {
      play: actions.toggle,
      reset: actions.reset,
      captions: () => player.tracks?.toggle(),
      settings: () => this.openMenu(!this.menu.open),
      headset: actions.headset,
      full: actions.fullscreen,
    });
    this.menu = new Menu(player, { ...actions, share: () => this.share(), about: () => this.about(), path: () => this.openPath(), loop: (on) => host.toggleAttribute("loop", on) });
    this.dialog = new Dialog(() => player.canvas.focus(), signal);
    this.full = new Fullscreen(host, () => this.update(), signal);
    this.holder.append(this.messages.box, this.statistics, this.bar.box, this.menu.box, this.dialog.box);
    root.append(this.holder);
    // On the bundled page keys work wherever the focus is.
    const keyboard = host.closest("[data-splatreel-page]") ? document.documentElement : host;
    this.keys = attachKeys(keyboard, player, actions, signal);
    this.idle = new AutoHide(host, this.holder, player, () => this.bar.seek.dragging || this.menu.open || this.dialog.open !== "", signal);
    keyboard.addEventListener("keydown", () => this.idle.wake(), { signal });
    this.listen();
    this.update();
  }

  /** Show a text for some seconds. */
  say(words: string): void {
    this.messages.say(words);
  }

  /** Remove the controls. */
  remove(): void {
    this.life.abort();
    this.headset?.leave();
    this.path?.close();
    this.holder.remove();
  }

  /** Return the actions of keys, buttons and the menu. */
  private actions() {
    const { player } = this;
    return {
      toggle: () => (player.paused ? player.play() : player.pause()),
      fullscreen: () => void this.full.toggle().catch(() => this.messages.say("The browser does not allow fullscreen")),
      headset: () => this.toggleHeadset(),
      reset: () => player.camera?.reset(),
      fly: () => this.fly(),
      statistics: () => this.toggleStatistics(),
      picture: () => void this.saveScreenshot(),
      help: () => (this.dialog.open === HELP ? this.dialog.close() : void this.help()),
      escape: () => this.closeSheets(),
    };
  }

  private listen(): void {
    const { player, life: { signal } } = this;
    for (const name of EVENTS) player.addEventListener(name, () => this.update(), { signal });
    player.canvas.addEventListener("pointerdown", () => this.openMenu(false), { signal });
    void hasHeadset().then((there) => (this.bar.button("headset").hidden = !there));
    const timer = setInterval(() => this.showStatistics(), 250);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  private toggleHeadset(): void {
    if (this.headset) return this.headset.leave();
    if (this.bar.button("headset").hidden) return;
    const ended = (): void => {
      this.headset = null;
      this.update();
    };
    const enter = async (): Promise<void> => {
      const { Headset } = await loadPart("headset.js", () => import("../player/headset"));
      this.headset = await Headset.enter(this.player, ended);
      this.update();
    };
    enter().catch((error) => this.messages.say(`The headset cannot be used: ${messageOf(error)}`));
  }

  private async saveScreenshot(): Promise<void> {
    try {
      const { saveScreenshot } = await loadPart("screenshot.js", () => import("./screenshot"));
      await saveScreenshot(this.player);
    } catch (error) {
      this.messages.say(messageOf(error));
    }
  }

  private fly(): void {
    const { camera } = this.player;
    camera?.fly(!camera.flying);
    this.menu.update();
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

  private help(): Promise<void> {
    return this.withPart(loadPart("help.js", () => import("./help")), ({ helpOf }) => this.show(HELP, helpOf(this.root, this.keys)));
  }

  private toggleStatistics(): void {
    this.statistics.hidden = !this.statistics.hidden;
    this.showStatistics();
    this.menu.update({ statistics: !this.statistics.hidden });
  }

  private showStatistics(): void {
    const { statistics, player: { stats } } = this;
    if (!statistics.hidden && stats) statistics.innerHTML = describe(stats).map(([name, value]) => `<dt>${name}</dt><dd>${value}</dd>`).join("");
  }

  private show(title: string, content: HTMLElement): void {
    this.openMenu(false);
    this.dialog.show(title, content);
  }

  private about(): void {
    const { presentation } = this.player.manifest!;
    this.show(presentation.title || "About this reel", aboutOf(presentation));
  }

  private share(): void {
    const { host, player: { manifest } } = this;
    this.openMenu(false);
    void this.withPart(loadPart("share.js", () => import("./share")), ({ shareOf }) => {
      const shared = { link: host.link, page: location.href.split("#")[0], reel: manifest!.url, player: playerAddress(), title: manifest!.presentation.title };
      this.show("Share", shareOf(this.root, shared, (words) => this.say(words)));
    });
  }

  /** Close the open dialog or menu, or else leave fullscreen. */
  private closeSheets(): void {
    if (this.dialog.open) this.dialog.close();
    else if (this.menu.open) {
      this.openMenu(false);
      this.bar.button("settings").focus();
    } else this.full.leave();
  }

  private openMenu(open: boolean): void {
    this.menu.open = open;
    this.bar.button("settings").setAttribute("aria-expanded", String(open));
  }

  private update(): void {
    const { manifest } = this.player;
    this.bar.update({ full: this.full.on, fullLabel: this.full.offer, presenting: this.headset !== null });
    this.messages.update();
    this.menu.update({ shares: this.host.hasAttribute("share") && !!manifest && !manifest.files, describes: !!manifest && hasTexts(manifest.presentation) });
    this.idle.update();
  }
}
