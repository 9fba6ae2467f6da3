/** The settings menu above the bar. This part is loaded on demand. */
import type { Player } from "../player/player";
import type { Quality } from "@splatreel/renderer";
import { BACK, ON } from "./icons";
import { elementOf } from "./markup";
import fields from "./fields.css";
import styles from "./menu.css";
import { adoptStyles, markOverflow } from "./styles";

const RATES = [0.25, 0.5, 0.75, 1, 1.25, 1.5, 2];
const QUALITIES: [Quality, string][] = [
  ["auto", "Automatic"],
  ["full", "Full"],
  ["half", "Half"],
];

const option = (value: string | number, text: string): string => `<option value="${value}">${text}</option>`;
const choice = (name: string, text: string, options: string[]): string =>
  `<label>${text}<select name="${name}">${options.join("")}</select></label>`;
const toggle = (name: string, text: string): string =>
  `<label>${text}<input type="checkbox" role="switch" name="${name}" /></label>`;

const MARKUP = [
  choice(
    "rate",
    "Speed",
    RATES.map((rate) => option(rate, `${rate} ×`)),
  ),
  choice("rendition", "Quality", []),
  choice("captions", "Captions", []),
  choice("chapter", "Chapter", []),
  choice(
    "quality",
    "Resolution",
    QUALITIES.map(([value, text]) => option(value, text)),
  ),
  toggle("loop", "Loop"),
  toggle("spatial", "Spatial sound"),
  toggle("fly", "Fly through the cameras"),
  toggle("statistics", "Statistics"),
  `<button type="button" name="walk" class="wide">Walk mode</button>`,
  `<button type="button" name="path" class="wide">Camera path</button>`,
  `<button type="button" name="edit" class="wide">Crop and clean</button>`,
  `<div class="frames">Frame<span><button type="button" name="back" aria-label="One frame back">${BACK}</button><button type="button" name="on" aria-label="One frame forward">${ON}</button></span></div>`,
  `<button type="button" name="share" class="wide">Share</button>`,
  `<button type="button" name="picture" class="wide">Save a picture</button>`,
  `<button type="button" name="about" class="wide">About this reel</button>`,
  `<button type="button" name="help" class="wide">Keys and gestures</button>`,
].join("");

/** Actions of the menu. */
export interface MenuActions {
  fly(): void;
  statistics(): void;
  help(): void;
  share(): void;
  picture(): void;
  about(): void;
  walk(): void;
  path(): void;
  edit(): void;
  loop(on: boolean): void;
}

/** State of the menu that is not in the player. */
export interface MenuState {
  statistics: boolean;
  /** True if the page opens links to a time and a view. */
  shares: boolean;
  /** True if the reel has texts about itself. */
  describes: boolean;
}

/** The menu of one player. */
export class Menu {
  readonly box: HTMLElement;
  private readonly mark: () => void;

  /** state: returns the state that is not in the player. */
  constructor(
    root: ShadowRoot,
    private readonly player: Player,
    actions: MenuActions,
    private readonly state: () => MenuState,
  ) {
    adoptStyles(root, fields);
    adoptStyles(root, styles);
    this.box = elementOf(
      `<div class="sheet menu" role="group" aria-label="Settings" hidden>${MARKUP}</div>`,
      player.words,
    );
    this.mark = markOverflow(this.box);
    this.input("rate").onchange = () => void (player.playbackRate = Number(this.input("rate").value));
    this.input("rendition").onchange = () =>
      void (player.rendition = player.renditions[Number(this.input("rendition").value) - 1] ?? null);
    this.input("quality").onchange = () => {
      player.resolution.quality = this.input("quality").value as Quality;
      player.invalidate();
    };
    this.input("captions").onchange = () => void (player.tracks!.shown = Number(this.input("captions").value) - 1);
    this.input("chapter").onchange = () => {
      const chapter = player.tracks?.chapters[Number(this.input("chapter").value)];
      if (chapter) player.currentTime = chapter.start;
    };
    this.input("loop").onchange = () => actions.loop(this.input("loop").checked);
    this.input("spatial").onchange = () => void (player.soundtrack.spatial.on = this.input("spatial").checked);
    this.input("fly").onchange = () => actions.fly();
    this.input("statistics").onchange = () => actions.statistics();
    this.input("back").onclick = () => player.step(-1);
    this.input("on").onclick = () => player.step(1);
    for (const name of ["walk", "path", "edit", "share", "picture", "about", "help"] as const)
      this.input(name).onclick = () => actions[name]();
  }

  get open(): boolean {
    return !this.box.hidden;
  }

  set open(open: boolean) {
    this.box.hidden = !open;
    this.update();
  }

  /** Show the present state. */
  update(): void {
    if (!this.open) return;
    const { player } = this;
    const state = this.state();
    this.input("rate").value = String(player.playbackRate);
    this.updateRenditions();
    this.updateTracks();
    this.input("quality").value = player.resolution.quality;
    this.input("loop").checked = player.loop;
    this.input("spatial").checked = player.soundtrack.spatial.on;
    this.input("spatial").parentElement!.hidden = !player.soundtrack.placed;
    this.input("fly").checked = player.camera?.flying === true;
    this.input("statistics").checked = state.statistics;
    this.input("share").hidden = !state.shares;
    this.input("about").hidden = !state.describes;
    this.mark();
  }

  /** Update the list of renditions. "Auto" names the rendition on screen. */
  private updateRenditions(): void {
    const { renditions, rendition, shownRendition, words: t } = this.player;
    const auto = shownRendition && rendition === null ? `${t("Auto")} (${shownRendition})` : t("Auto");
    this.offer(
      "rendition",
      renditions.length > 0 ? [auto, ...renditions] : [],
      renditions.indexOf(rendition ?? "") + 1,
    );
  }

  private updateTracks(): void {
    const { tracks, currentTime } = this.player;
    const [captions, chapters] = [tracks?.captions ?? [], tracks?.chapters ?? []];
    this.offer(
      "captions",
      captions.length > 0 ? [this.player.words("Off"), ...captions] : [],
      (tracks?.shown ?? -1) + 1,
    );
    this.offer(
      "chapter",
      chapters.map(({ title }) => title),
      tracks?.chapterAt(currentTime) ?? -1,
    );
  }

  /** Let people choose among texts; hidden without any. chosen: index of the present one, the option's value. */
  private offer(name: string, texts: string[], chosen: number): void {
    const select = this.box.querySelector<HTMLSelectElement>(`[name=${name}]`)!;
    select.parentElement!.hidden = texts.length === 0;
    if (texts.join("\n") !== [...select.options].map(({ text }) => text).join("\n")) {
      select.replaceChildren(...texts.map((text, index) => new Option(text, String(index || ""))));
    }
    if (select.selectedIndex !== chosen) select.selectedIndex = chosen;
  }

  private input(name: string): HTMLInputElement {
    return this.box.querySelector<HTMLInputElement>(`[name=${name}]`)!;
  }
}
