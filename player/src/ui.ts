/** The controls over the picture: play, seek, time, reset view, fullscreen; loading and error states; keys. */
import type { Player } from "./player";

/** The controls fade after this many milliseconds without a move, while playing. */
const FADE_AFTER = 2600;
const ARROW_SECONDS = 1;

const icon = (body: string): string => `<svg viewBox="0 0 24 24" aria-hidden="true">${body}</svg>`;
const PLAY = icon('<path class="solid" d="M8 5.5v13l10.5-6.5z"/>');
const PAUSE = icon('<path d="M8.5 5.5v13M15.5 5.5v13" stroke-width="3"/>');
const RESET = icon('<path d="M4 12a8 8 0 1 0 2.6-5.9L4 8.5M4 4v4.5h4.5"/>');
const FULL = icon('<path d="M9 4H4v5M15 4h5v5M9 20H4v-5M15 20h5v-5"/>');
const SMALL = icon('<path d="M4 9h5V4M20 9h-5V4M4 15h5v5M20 15h-5v5"/>');

const MARKUP = `
  <div class="center">
    <div class="spinner" role="status" aria-label="Loading"></div>
    <button class="start" type="button" aria-label="Play" tabindex="-1" hidden>${PLAY}</button>
    <div class="panel" role="alert" hidden><h2>This reel cannot be played</h2><p></p><button type="button" class="retry">Try again</button></div>
  </div>
  <div class="bar" role="group" aria-label="Player controls">
    <input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" />
    <div class="row">
      <button type="button" class="play" aria-label="Play">${PLAY}</button>
      <div class="time" aria-hidden="true">0:00 <span>/ 0:00</span></div>
      <div class="gap"></div>
      <button type="button" class="reset" aria-label="Reset view" title="Reset view (r)">${RESET}</button>
      <button type="button" class="full" aria-label="Fullscreen" title="Fullscreen (f)">${FULL}</button>
    </div>
  </div>`;

export class Controls {
  private readonly bar: HTMLElement;
  private readonly seek: HTMLInputElement;
  private readonly time: HTMLElement;
  private readonly spinner: HTMLElement;
  private readonly panel: HTMLElement;
  private readonly start: HTMLButtonElement;
  private readonly playButton: HTMLButtonElement;
  private readonly fullButton: HTMLButtonElement;
  private fade = 0;
  private dragging = false;

  constructor(private readonly host: HTMLElement, root: ShadowRoot, private readonly player: Player) {
    const holder = document.createElement("div");
    holder.innerHTML = MARKUP;
    root.append(...holder.children);
    const find = <T extends HTMLElement>(name: string): T => root.querySelector<T>(name)!;
    this.bar = find(".bar");
    this.seek = find(".seek");
    this.time = find(".time");
    this.spinner = find(".spinner");
    this.panel = find(".panel");
    this.start = find(".start");
    this.playButton = find(".play");
    this.fullButton = find(".full");
    this.playButton.onclick = () => this.toggle();
    this.start.onclick = () => this.toggle();
    this.fullButton.onclick = () => this.toggleFullscreen();
    find(".reset").onclick = () => this.resetView();
    find(".retry").onclick = () => {
      player.retry();
      this.update();
    };
    this.listen();
    this.update();
  }

  private listen(): void {
    const { player, host, seek } = this;
    const events = ["loadedmetadata", "canplay", "play", "pause", "timeupdate", "progress", "waiting", "playing", "seeked", "ended", "error"];
    for (const name of events) player.addEventListener(name, () => this.update());
    seek.addEventListener("input", () => {
      this.dragging = true;
      player.currentTime = Number(seek.value);
    });
    seek.addEventListener("change", () => (this.dragging = false));
    host.addEventListener("keydown", (event) => this.key(event));
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"]) host.addEventListener(name, () => this.wake());
    host.addEventListener("pointerleave", () => this.sleep());
    document.addEventListener("fullscreenchange", () => this.update());
  }

  private toggle(): void {
    if (this.player.paused) this.player.play();
    else this.player.pause();
  }

  private toggleFullscreen(): void {
    if (document.fullscreenElement) void document.exitFullscreen();
    else void this.host.requestFullscreen?.();
  }

  private resetView(): void {
    this.player.camera?.reset();
    this.player.invalidate();
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.composedPath()[0];
    if (event.key === " " && target instanceof HTMLButtonElement) return;
    const { player } = this;
    const actions: Record<string, () => void> = {
      " ": () => this.toggle(),
      k: () => this.toggle(),
      ArrowLeft: () => (player.currentTime -= ARROW_SECONDS),
      ArrowRight: () => (player.currentTime += ARROW_SECONDS),
      Home: () => (player.currentTime = 0),
      End: () => (player.currentTime = player.duration),
      f: () => this.toggleFullscreen(),
      r: () => this.resetView(),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  private wake(): void {
    this.host.classList.remove("idle");
    clearTimeout(this.fade);
    this.fade = window.setTimeout(() => this.sleep(), FADE_AFTER);
  }

  private sleep(): void {
    const busy = this.player.paused || this.player.error || this.dragging || this.bar.matches(":has(:focus-visible)");
    this.host.classList.toggle("idle", !busy);
  }

  private update(): void {
    const { player, seek } = this;
    const { duration, currentTime, paused, error } = player;
    const playable = player.manifest !== null;
    this.bar.hidden = !playable;
    this.panel.hidden = !error;
    if (error) this.panel.querySelector("p")!.textContent = error.message;
    this.spinner.hidden = error !== null || (player.canPlay && !player.waiting);
    this.start.hidden = !(player.canPlay && paused && currentTime === 0 && !error && this.spinner.hidden);
    seek.max = String(duration);
    if (!this.dragging) seek.value = String(currentTime);
    seek.setAttribute("aria-valuetext", `${clock(currentTime)} of ${clock(duration)}`);
    seek.style.setProperty("--played", `${percent(currentTime, duration)}%`);
    seek.style.setProperty("--ahead", this.bufferedTrack());
    this.time.innerHTML = `${clock(currentTime)} <span>/ ${clock(duration)}</span>`;
    setButton(this.playButton, paused ? PLAY : PAUSE, paused ? "Play" : "Pause");
    const full = document.fullscreenElement !== null;
    setButton(this.fullButton, full ? SMALL : FULL, full ? "Leave fullscreen" : "Fullscreen");
    if (paused || error) this.host.classList.remove("idle");
    else if (!this.fade) this.wake();
  }

  /** The ranges that are here, as a background. */
  private bufferedTrack(): string {
    const { buffered, duration } = this.player;
    const stops = buffered.flatMap(([from, to]) => {
      const [a, b] = [percent(from, duration), percent(to, duration)];
      return [`transparent ${a}%`, `rgb(255 255 255 / 0.32) ${a}%`, `rgb(255 255 255 / 0.32) ${b}%`, `transparent ${b}%`];
    });
    return stops.length > 0 ? `linear-gradient(to right, ${stops.join(", ")})` : "linear-gradient(transparent, transparent)";
  }
}

function setButton(button: HTMLButtonElement, markup: string, label: string): void {
  if (button.getAttribute("aria-label") === label) return;
  button.innerHTML = markup;
  button.setAttribute("aria-label", label);
}

function percent(part: number, whole: number): number {
  return whole > 0 ? Math.round((10000 * part) / whole) / 100 : 0;
}

/** Seconds as m:ss. */
export function clock(seconds: number): string {
  const whole = Math.floor(seconds + 1e-6);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}
