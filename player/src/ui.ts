/** The controls over the picture: bar, menu, help and statistics; loading and error states. */
import { messageOf } from "./errors";
import { hasHeadset, Headset } from "./headset";
import { CLOSE, FULL, HEADSET, PAUSE, PLAY, RESET, SETTINGS, SMALL } from "./icons";
import { attachKeys } from "./keys";
import { Menu } from "./menu";
import type { Player } from "./player";
import { describe } from "./stats";

/** The controls fade after this many milliseconds without a move, while playing. */
const FADE_AFTER = 2600;
/** A wait longer than this, milliseconds, is explained. */
const EXPLAIN_AFTER = 1500;
const TOAST = 2200;

const MARKUP = `
  <div class="center">
    <div class="wait" role="status" hidden><div class="spinner"></div><p>Loading</p></div>
    <button class="start" type="button" aria-label="Play" tabindex="-1" hidden>${PLAY}</button>
    <div class="toast" role="status"></div>
    <div class="sheet panel" role="alert" hidden><h2>This reel cannot be played</h2><p></p><button type="button" class="retry">Try again</button></div>
  </div>
  <dl class="sheet stats" aria-label="Statistics" hidden></dl>
  <div class="bar" role="group" aria-label="Player controls">
    <div class="track"><input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" /><span class="hint" aria-hidden="true"></span></div>
    <div class="row">
      <button type="button" class="play" aria-label="Play">${PLAY}</button>
      <div class="time" aria-hidden="true">0:00 <span>/ 0:00</span></div>
      <button type="button" class="live" hidden>Live</button>
      <div class="gap"></div>
      <button type="button" class="reset" aria-label="Reset view" title="Reset view (r)">${RESET}</button>
      <button type="button" class="settings" aria-label="Settings" title="Settings" aria-expanded="false">${SETTINGS}</button>
      <button type="button" class="headset" aria-label="Enter VR" title="Enter VR (v)" hidden>${HEADSET}</button>
      <button type="button" class="full" aria-label="Fullscreen" title="Fullscreen (f)">${FULL}</button>
    </div>
  </div>
  <div class="sheet menu" role="group" aria-label="Settings" hidden></div>
  <div class="sheet help" role="dialog" aria-label="Keys" hidden><button type="button" class="close" aria-label="Close">${CLOSE}</button></div>`;

export class Controls {
  private readonly holder = document.createElement("div");
  private readonly seek: HTMLInputElement;
  private readonly stops: HTMLElement[];
  private readonly menu: Menu;
  private readonly life = new AbortController();
  private fade = 0;
  private explain = 0;
  private toast = 0;
  private dragging = false;
  private headset: Headset | null = null;

  constructor(private readonly host: HTMLElement & { readonly link: string }, root: ShadowRoot, private readonly player: Player) {
    this.holder.className = "ui";
    this.holder.innerHTML = MARKUP;
    root.append(this.holder);
    this.seek = this.find<HTMLInputElement>(".seek");
    this.stops = [this.seek, ...this.holder.querySelectorAll<HTMLElement>(".row button")];
    this.menu = new Menu(this.find(".menu"), player, {
      fly: () => this.fly(),
      statistics: () => this.toggleStatistics(),
      help: () => this.toggleHelp(),
      share: () => this.share(),
      loop: (on) => host.toggleAttribute("loop", on),
    });
    this.listen();
    this.listenToButtons();
    this.stop(1);
    this.update();
  }

  /** Take the controls away. */
  remove(): void {
    this.life.abort();
    this.headset?.leave();
    this.holder.remove();
    clearTimeout(this.fade);
  }

  private find<T extends HTMLElement>(name: string): T {
    return this.holder.querySelector<T>(name)!;
  }

  private listen(): void {
    const { player, host, seek, life: { signal } } = this;
    const events = ["loadstart", "loadedmetadata", "durationchange", "canplay", "play", "pause", "timeupdate", "progress", "waiting", "playing"];
    for (const name of [...events, "seeking", "seeked", "ratechange", "ended", "error"]) player.addEventListener(name, () => this.update(), { signal });
    seek.addEventListener("input", () => {
      this.dragging = true;
      player.currentTime = Number(seek.value);
    });
    seek.addEventListener("change", () => (this.dragging = false));
    this.find(".track").addEventListener("pointermove", (event) => this.hint(event));
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"]) host.addEventListener(name, () => this.wake(), { signal });
    host.addEventListener("pointerleave", () => this.sleep(), { signal });
    document.addEventListener("fullscreenchange", () => this.update(), { signal });
    this.find(".bar").addEventListener("keydown", (event) => this.rove(event));
    const timer = setInterval(() => this.showStatistics(), 250);
    signal.addEventListener("abort", () => clearInterval(timer));
    const actions = {
      toggle: () => this.toggle(),
      fullscreen: () => this.toggleFullscreen(),
      headset: () => this.toggleHeadset(),
      reset: () => player.camera?.reset(),
      fly: () => this.fly(),
      statistics: () => this.toggleStatistics(),
      help: () => this.toggleHelp(),
      escape: () => this.closeSheets(),
    };
    const table = attachKeys(host, player, actions, signal);
    const lines = table.map(([title, list]) => `<section><h3>${title}</h3><dl>${list.map(({ shown, what }) => `<dt>${keycaps(shown)}</dt><dd>${what}</dd>`).join("")}</dl></section>`);
    this.find(".help").insertAdjacentHTML("beforeend", `<h2>Keys</h2><div class="columns">${lines.join("")}</div>
      <p>Drag to turn, right or Shift drag or two fingers to move, scroll or pinch for nearer and farther, double-click to choose the middle.</p>`);
  }

  private listenToButtons(): void {
    const { player } = this;
    const click = (name: string, act: () => void): void => void (this.find(name).onclick = act);
    click(".play", () => this.toggle());
    click(".start", () => this.toggle());
    click(".full", () => this.toggleFullscreen());
    click(".headset", () => this.toggleHeadset());
    void hasHeadset().then((there) => (this.find(".headset").hidden = !there));
    click(".reset", () => player.camera?.reset());
    click(".live", () => {
      player.currentTime = player.clock.edge;
      player.play();
    });
    click(".retry", () => player.retry());
    click(".settings", () => this.openMenu(!this.menu.open));
    click(".help .close", () => this.toggleHelp());
    this.player.canvas.addEventListener("pointerdown", () => this.openMenu(false), { signal: this.life.signal });
  }

  private toggle(): void {
    if (this.player.paused) this.player.play();
    else this.player.pause();
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
    if (this.find(".headset").hidden) return;
    const ended = (): void => {
      this.headset = null;
      this.update();
    };
    Headset.enter(this.player, ended).then(
      (headset) => {
        this.headset = headset;
        this.update();
      },
      (error) => this.say(`The headset cannot be used: ${messageOf(error)}`),
    );
  }

  private fly(): void {
    const { camera } = this.player;
    camera?.fly(!camera.flying);
    this.menu.update();
  }

  private toggleStatistics(): void {
    const box = this.find(".stats");
    box.hidden = !box.hidden;
    this.showStatistics();
    this.menu.statistics = !box.hidden;
    this.menu.update();
  }

  private showStatistics(): void {
    const box = this.find(".stats");
    const { stats } = this.player;
    if (!box.hidden && stats) box.innerHTML = describe(stats).map(([name, value]) => `<dt>${name}</dt><dd>${value}</dd>`).join("");
  }

  private toggleHelp(): void {
    const help = this.find(".help");
    help.hidden = !help.hidden;
    this.openMenu(false);
    if (help.hidden) this.player.canvas.focus();
    else this.find(".help .close").focus();
  }

  private closeSheets(): void {
    if (!this.find(".help").hidden) this.toggleHelp();
    else if (this.menu.open) {
      this.openMenu(false);
      this.find(".settings").focus();
    } else this.host.classList.remove("filling");
  }

  private openMenu(open: boolean): void {
    this.menu.open = open;
    this.find(".settings").setAttribute("aria-expanded", String(open));
  }

  private async share(): Promise<void> {
    const { link } = this.host;
    this.openMenu(false);
    const copied = await navigator.clipboard?.writeText(link).then(() => true, () => false);
    if (!copied) history.replaceState(null, "", link);
    this.say(copied ? "Link copied" : "The link is in the address bar");
  }

  private say(text: string): void {
    const box = this.find(".toast");
    box.textContent = text;
    box.classList.add("shown");
    clearTimeout(this.toast);
    this.toast = window.setTimeout(() => box.classList.remove("shown"), TOAST);
  }

  /** One tab stop into the controls: arrows go from button to button, up and down to the seek bar and back. */
  private rove(event: KeyboardEvent): void {
    const stops = this.stops.filter((stop) => !stop.hidden);
    const at = stops.indexOf(event.composedPath()[0] as HTMLElement);
    if (at < 0 || event.shiftKey) return;
    const onSeek = at === 0; // where left and right move time
    const ways = { ArrowUp: 0, ArrowDown: Math.max(at, 1), ArrowLeft: onSeek ? null : Math.max(at - 1, 1), ArrowRight: onSeek ? null : Math.min(at + 1, stops.length - 1) };
    const next = ways[event.key as keyof typeof ways] ?? null;
    if (next === null) return;
    event.preventDefault();
    event.stopPropagation();
    this.stop(this.stops.indexOf(stops[next]));
    stops[next].focus();
  }

  private stop(at: number): void {
    for (const [index, stop] of this.stops.entries()) stop.tabIndex = index === at ? 0 : -1;
  }

  private hint(event: PointerEvent): void {
    const { left, width } = this.seek.getBoundingClientRect();
    const part = Math.min(Math.max((event.clientX - left) / width, 0), 1);
    const hint = this.find(".hint");
    hint.textContent = clock(part * this.player.duration, true);
    hint.style.left = `${Math.min(Math.max(part * width, 24), width - 24)}px`;
  }

  private wake(): void {
    this.host.classList.remove("idle");
    clearTimeout(this.fade);
    this.fade = window.setTimeout(() => this.sleep(), FADE_AFTER);
  }

  private sleep(): void {
    const busy = this.player.paused || this.player.error || this.dragging || this.menu.open || this.holder.matches(":has(:focus-visible)");
    this.host.classList.toggle("idle", !busy);
  }

  private update(): void {
    const { player, seek, host } = this;
    const { duration, currentTime, paused, error, live } = player;
    this.find(".bar").hidden = player.manifest === null;
    this.find(".panel").hidden = !error;
    if (error) this.find(".panel p").textContent = error.message;
    this.updateWait(error === null && (!player.canPlay || player.waiting));
    this.find(".start").hidden = !(player.canPlay && paused && currentTime === 0 && !error && !player.waiting);
    seek.max = String(duration);
    if (!this.dragging) seek.value = String(currentTime);
    seek.setAttribute("aria-valuetext", `${clock(currentTime)} of ${clock(duration)}`);
    seek.style.setProperty("--played", `${percent(currentTime, duration)}%`);
    seek.style.setProperty("--ahead", this.bufferedTrack());
    this.find(".time").innerHTML = `${clock(currentTime)} <span>/ ${clock(duration)}</span>`;
    const badge = this.find(".live");
    badge.hidden = !live;
    badge.classList.toggle("on", currentTime >= player.clock.edge);
    setButton(this.find(".play"), paused ? PLAY : PAUSE, paused ? "Play" : "Pause", "k");
    const full = document.fullscreenElement !== null || host.classList.contains("filling");
    setButton(this.find(".full"), full ? SMALL : FULL, full ? "Leave fullscreen" : "Fullscreen", "f");
    setButton(this.find(".headset"), HEADSET, this.headset ? "Leave VR" : "Enter VR", "v");
    this.menu.update();
    if (paused || error) host.classList.remove("idle");
    else if (!this.fade) this.wake();
  }

  /** Wheel at once, words once it takes long. */
  private updateWait(waiting: boolean): void {
    const wait = this.find(".wait");
    if (waiting && wait.hidden) {
      wait.classList.remove("long");
      this.explain = window.setTimeout(() => wait.classList.add("long"), EXPLAIN_AFTER);
    }
    if (!waiting) clearTimeout(this.explain);
    wait.hidden = !waiting;
    const text = this.player.notice ?? "Loading";
    const words = wait.querySelector("p")!;
    if (words.textContent !== text) words.textContent = text;
  }

  /** The ranges that are here, as a background. */
  private bufferedTrack(): string {
    const { buffered, duration } = this.player;
    const stops = buffered.flatMap(([from, to]) => {
      const [a, b] = [percent(from, duration), percent(to, duration)];
      return [`transparent ${a}%`, `rgb(255 255 255 / 0.36) ${a}%`, `rgb(255 255 255 / 0.36) ${b}%`, `transparent ${b}%`];
    });
    return stops.length > 0 ? `linear-gradient(to right, ${stops.join(", ")})` : "linear-gradient(transparent, transparent)";
  }
}

function setButton(button: HTMLElement, markup: string, label: string, key: string): void {
  if (button.getAttribute("aria-label") === label && button.title) return;
  button.innerHTML = markup;
  button.setAttribute("aria-label", label);
  button.title = `${label} (${key})`;
}

function keycaps(shown: string): string {
  return shown.split(" ").map((key) => (key === "–" ? "–" : `<kbd>${key.replace("<", "&lt;")}</kbd>`)).join(" ");
}

function percent(part: number, whole: number): number {
  return whole > 0 ? Math.round((10000 * part) / whole) / 100 : 0;
}

/** Seconds as m:ss, with tenths if asked. */
export function clock(seconds: number, tenths = false): string {
  const whole = Math.floor(seconds + 1e-6);
  const rest = tenths ? `.${Math.floor((seconds - whole + 1e-6) * 10)}` : "";
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}${rest}`;
}
