/** The bar at the bottom: seek bar and buttons, which form one tab stop. */
import type { Player } from "../player/player";
import { CAPTIONS, CUBE, FULL, HEADSET, MUTED, PAUSE, PLAY, RESET, SETTINGS, SMALL, SOUND } from "./icons";
import { elementOf } from "./markup";
import type { HeadsetMode } from "../player/headset-support";
import { SeekBar } from "./seekbar";
import { timeText } from "./time-text";

const VOLUME_MARKUP = `<div class="volume" hidden>
  <button type="button" class="mute" aria-label="Mute" hidden>${SOUND}</button>
  <input class="level" type="range" min="0" max="1" step="0.05" aria-label="Volume" />
</div>`;

/** Keys that the slider handles. Elsewhere they control time, view or focus. Left and right go to the buttons beside it. */
const KEYS = ["ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];

/** The volume control of one player; hidden for a silent reel. */
class VolumeControl {
  readonly box: HTMLElement;
  private readonly button: HTMLButtonElement;
  private readonly slider: HTMLInputElement;

  constructor(private readonly player: Player) {
    this.box = elementOf(VOLUME_MARKUP, player.words);
    this.button = this.box.querySelector(".mute")!;
    this.slider = this.box.querySelector(".level")!;
    const { button, slider } = this;
    button.onclick = () => player.soundtrack.toggle();
    slider.addEventListener("input", () => {
      player.soundtrack.volume = Number(slider.value);
      player.soundtrack.muted = false;
    });
    slider.addEventListener("keydown", (event) => KEYS.includes(event.key) && event.stopPropagation());
  }

  /** Show the present state. */
  update(): void {
    const { button, slider } = this;
    const { available, muted, volume } = this.player.soundtrack;
    this.box.hidden = button.hidden = !available;
    const silent = muted || volume === 0;
    const label = this.player.words(silent ? "Unmute" : "Mute");
    if (button.title !== `${label} (m)`) {
      button.replaceChildren(elementOf(silent ? MUTED : SOUND));
      button.setAttribute("aria-label", label);
      button.title = `${label} (m)`;
    }
    slider.value = String(muted ? 0 : volume);
    slider.setAttribute("aria-valuetext", `${Math.round(100 * Number(slider.value))} %`);
  }
}

const MARKUP = `<div class="bar" role="group" aria-label="Player controls" dir="ltr">
  <div class="row">
    <button type="button" class="play" aria-label="Play">${PLAY}</button>
    <div class="time" aria-hidden="true">0:00 <span>/ 0:00</span></div>
    <button type="button" class="live" hidden>Live</button>
    <div class="gap"></div>
    <slot name="bar"></slot>
    <button type="button" class="captions" aria-label="Captions" title="Captions (t)" aria-pressed="false" hidden>${CAPTIONS}</button>
    <button type="button" class="reset" aria-label="Reset view" title="Reset view (r)">${RESET}</button>
    <button type="button" class="settings" aria-label="Settings" title="Settings" aria-expanded="false">${SETTINGS}</button>
    <button type="button" class="headset" aria-label="Enter VR" title="Enter VR (v)" hidden>${HEADSET}</button>
    <button type="button" class="ar" aria-label="Enter AR" hidden>${CUBE}</button>
    <button type="button" class="full" aria-label="Fullscreen" title="Fullscreen (f)">${FULL}</button>
  </div>
</div>`;

/** Actions of the buttons, by their classes. */
export interface BarActions {
  play(): void;
  captions(): void;
  reset(): void;
  settings(): void;
  headset(): void;
  ar(): void;
  full(): void;
}

/** State of the bar that is not in the player. */
export interface BarState {
  full: boolean;
  /** Label of the fullscreen button; "" to hide it. */
  fullLabel: string;
  /** What the headset shows; null for nothing. */
  presenting: HeadsetMode | null;
}

/** The bar of one player. */
export class Bar {
  readonly box: HTMLElement;
  readonly seek: SeekBar;
  private readonly volume: VolumeControl;
  /** Seek bar and buttons, in order. */
  private readonly stops: HTMLElement[];

  constructor(
    private readonly player: Player,
    actions: BarActions,
  ) {
    this.box = elementOf(MARKUP, player.words);
    this.seek = new SeekBar(player);
    this.box.prepend(this.seek.box);
    this.volume = new VolumeControl(player);
    this.button("gap").before(this.volume.box);
    this.stops = [this.seek.input, ...this.box.querySelectorAll<HTMLElement>(".row button, .level")];
    for (const [name, act] of Object.entries(actions)) this.button(name).onclick = () => act();
    this.button("live").onclick = () => {
      player.currentTime = player.clock.edge;
      player.play();
    };
    this.box.addEventListener("keydown", (event) => this.rove(event));
    this.box.addEventListener("focusin", ({ target }) => this.stop(this.stops.indexOf(target as HTMLElement)));
    this.stop(1);
  }

  /** Return a button by its class. */
  button(name: string): HTMLElement {
    return this.box.querySelector<HTMLElement>(`.${name}`)!;
  }

  /** Show the present state. */
  update({ full, fullLabel, presenting }: BarState): void {
    const { duration, currentTime, paused, live, clock, manifest, tracks, error, words: t } = this.player;
    // A reel that failed has no time. Only fullscreen can be left.
    this.box.hidden = manifest === null || (error !== null && !full);
    this.box.classList.toggle("failed", error !== null);
    this.seek.update();
    this.volume.update();
    const tenths = duration < 60;
    const [now, whole] = this.button("time").childNodes;
    now.textContent = `${timeText(currentTime, tenths)} `;
    whole.textContent = `/ ${timeText(duration, tenths)}`;
    this.button("live").hidden = !live;
    this.button("live").classList.toggle("on", currentTime >= clock.edge);
    this.button("captions").hidden = !tracks || tracks.captions.length === 0;
    this.button("captions").ariaPressed = String(tracks !== null && tracks.shown >= 0);
    this.set("play", paused ? PLAY : PAUSE, paused ? t("Play") : t("Pause"), "k");
    this.button("full").hidden = fullLabel === "";
    this.set("full", full ? SMALL : FULL, t(fullLabel), "f");
    this.set("headset", HEADSET, presenting === "vr" ? t("Leave VR") : t("Enter VR"), "v");
    if (this.stops.find(({ tabIndex }) => tabIndex === 0)?.closest("[hidden]")) this.stop(1);
    this.set("ar", CUBE, presenting === "ar" ? t("Leave AR") : t("Enter AR"), "");
  }

  /** key: "" for none. */
  private set(name: string, markup: string, label: string, key: string): void {
    const button = this.button(name);
    if (button.getAttribute("aria-label") === label && button.title) return;
    button.replaceChildren(elementOf(markup));
    button.setAttribute("aria-label", label);
    button.title = key ? `${label} (${key})` : label;
  }

  /** Move the focus by arrow keys: left and right between buttons, up and down between seek bar and buttons. */
  private rove(event: KeyboardEvent): void {
    const stops = this.stops.filter((stop) => stop.getClientRects().length > 0);
    const at = stops.indexOf(event.composedPath()[0] as HTMLElement);
    if (at < 0 || event.shiftKey || event.ctrlKey || event.altKey || event.metaKey) return;
    const onSeek = stops[at] === this.seek.input; // there left and right change the time
    const first = stops[0] === this.seek.input ? 1 : 0; // small embeds have no seek bar
    const ways = {
      ArrowUp: 0,
      ArrowDown: Math.max(at, first),
      ArrowLeft: onSeek ? null : Math.max(at - 1, first),
      ArrowRight: onSeek ? null : Math.min(at + 1, stops.length - 1),
    };
    const next = ways[event.key as keyof typeof ways] ?? null;
    if (next === null) return;
    event.preventDefault();
    event.stopPropagation();
    stops[next].focus();
  }

  /** Make a button the tab stop; -1 for none of them. */
  private stop(at: number): void {
    if (at < 0) return;
    for (const [index, stop] of this.stops.entries()) stop.tabIndex = index === at ? 0 : -1;
  }
}
