/** The controls over the picture, put together: bar, menu, help, statistics and messages, and what keys and buttons do. */
import { Bar } from "./bar";
import { Dialog } from "./dialog";
import { messageOf } from "./errors";
import { hasHeadset, Headset } from "./headset";
import { helpMarkup } from "./help";
import { Idle } from "./idle";
import { attachKeys } from "./keys";
import { elementOf } from "./markup";
import { Menu } from "./menu";
import { Messages } from "./messages";
import type { Player } from "./player";
import { describe } from "./stats";

/** Of the player: after these, what shows may be another. */
const EVENTS = ["emptied", "loadstart", "loadedmetadata", "durationchange", "canplay", "play", "pause", "timeupdate", "progress", "waiting", "playing"];
EVENTS.push("seeking", "seeked", "ratechange", "ended", "error");

export class Controls {
  private readonly holder = elementOf(`<div class="ui"></div>`);
  private readonly statistics = elementOf(`<dl class="sheet stats" aria-label="Statistics" hidden></dl>`);
  private readonly messages: Messages;
  private readonly bar: Bar;
  private readonly menu: Menu;
  private readonly help: Dialog;
  private readonly idle: Idle;
  private readonly life = new AbortController();
  private headset: Headset | null = null;

  constructor(private readonly host: HTMLElement & { readonly link: string }, root: ShadowRoot, private readonly player: Player) {
    const actions = this.actions();
    this.messages = new Messages(player);
    this.bar = new Bar(player, {
      play: actions.toggle,
      reset: actions.reset,
      settings: () => this.openMenu(!this.menu.open),
      headset: actions.headset,
      full: actions.fullscreen,
    });
    this.menu = new Menu(player, { ...actions, share: () => this.share(), loop: (on) => host.toggleAttribute("loop", on) });
    this.help = new Dialog("help", "Keys", () => player.canvas.focus(), this.life.signal);
    this.help.box.insertAdjacentHTML("beforeend", helpMarkup(attachKeys(host, player, actions, this.life.signal)));
    this.holder.append(this.messages.box, this.statistics, this.bar.box, this.menu.box, this.help.box);
    root.append(this.holder);
    this.idle = new Idle(host, this.holder, player, () => this.bar.seek.dragging || this.menu.open || this.help.open, this.life.signal);
    this.listen();
    this.update();
  }

  /** Take the controls away. */
  remove(): void {
    this.life.abort();
    this.headset?.leave();
    this.holder.remove();
  }

  /** What keys, buttons and the menu do. */
  private actions() {
    const { player } = this;
    return {
      toggle: () => (player.paused ? player.play() : player.pause()),
      fullscreen: () => this.toggleFullscreen(),
      headset: () => this.toggleHeadset(),
      reset: () => player.camera?.reset(),
      fly: () => this.fly(),
      statistics: () => this.toggleStatistics(),
      help: () => this.toggleHelp(),
      escape: () => this.closeSheets(),
    };
  }

  private listen(): void {
    const { player, life: { signal } } = this;
    for (const name of EVENTS) player.addEventListener(name, () => this.update(), { signal });
    document.addEventListener("fullscreenchange", () => this.update(), { signal });
    player.canvas.addEventListener("pointerdown", () => this.openMenu(false), { signal });
    void hasHeadset().then((there) => (this.bar.button("headset").hidden = !there));
    const timer = setInterval(() => this.showStatistics(), 250);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  private toggleFullscreen(): void {
    const { host } = this;
    if (document.fullscreenElement) void document.exitFullscreen();
    else if (host.requestFullscreen) void host.requestFullscreen();
    else host.classList.toggle("filling"); // phones that give only films the whole screen
    this.update();
  }

  private toggleHeadset(): void {
    if (this.headset) return this.headset.leave();
    if (this.bar.button("headset").hidden) return;
    const ended = (): void => {
      this.headset = null;
      this.update();
    };
    Headset.enter(this.player, ended).then(
      (headset) => {
        this.headset = headset;
        this.update();
      },
      (error) => this.messages.say(`The headset cannot be used: ${messageOf(error)}`),
    );
  }

  private fly(): void {
    const { camera } = this.player;
    camera?.fly(!camera.flying);
    this.menu.update();
  }

  private toggleStatistics(): void {
    this.statistics.hidden = !this.statistics.hidden;
    this.showStatistics();
    this.menu.statistics = !this.statistics.hidden;
    this.menu.update();
  }

  private showStatistics(): void {
    const { statistics, player: { stats } } = this;
    if (!statistics.hidden && stats) statistics.innerHTML = describe(stats).map(([name, value]) => `<dt>${name}</dt><dd>${value}</dd>`).join("");
  }

  private toggleHelp(): void {
    this.openMenu(false);
    this.help.open = !this.help.open;
  }

  private closeSheets(): void {
    if (this.help.open) this.help.open = false;
    else if (this.menu.open) {
      this.openMenu(false);
      this.bar.button("settings").focus();
    } else this.host.classList.remove("filling");
  }

  private openMenu(open: boolean): void {
    this.menu.open = open;
    this.bar.button("settings").setAttribute("aria-expanded", String(open));
  }

  private async share(): Promise<void> {
    const { link } = this.host;
    this.openMenu(false);
    const copied = await navigator.clipboard?.writeText(link).then(() => true, () => false);
    if (!copied) history.replaceState(null, "", link);
    this.messages.say(copied ? "Link copied" : "The link is in the address bar");
  }

  private update(): void {
    const full = document.fullscreenElement !== null || this.host.classList.contains("filling");
    this.bar.update({ full, presenting: this.headset !== null });
    this.messages.update();
    this.menu.update();
    this.idle.update();
  }
}
