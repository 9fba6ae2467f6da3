/** The panel for editing a camera path. This part is loaded on demand. */
import { type Keyframe, nearestFirst, type PathFile } from "../camera/camera-path";
import { messageOf } from "@splatreel/decoder/internal";
import type { PathPlayer } from "../player/path-player";
import type { Player } from "../player/player";
import { CLOSE, PAUSE, PLAY } from "./icons";
import { directionOf } from "../base/words";
import { foldByHeader } from "./fold";
import { elementOf } from "./markup";
import { PathDrawing } from "./path-drawing";
import fields from "./fields.css";
import styles from "./path-panel.css";
import { adoptStyles } from "./styles";

/** Seconds between keyframes of the same reel time. */
const STEP = 2;
/** Minimum seconds between keyframes. */
const LEAST = 0.1;

/** Append a keyframe, as much later as its reel time is later, so that the reel plays at its own rate. */
export function appended(keyframes: Keyframe[], time: number, viewmat: number[]): Keyframe[] {
  const last = keyframes.at(-1);
  const later = last ? time - last.time : 0;
  return [...keyframes, { at: last ? rounded(last.at + (later >= LEAST ? later : STEP)) : 0, time, viewmat }];
}

/** Remove a keyframe. The path begins at 0 again. */
export function without(keyframes: Keyframe[], index: number): Keyframe[] {
  const left = keyframes.filter((_, i) => i !== index);
  const first = left[0]?.at ?? 0;
  return left.map((keyframe) => ({ ...keyframe, at: rounded(keyframe.at - first) }));
}

/** Move a keyframe to another time after the one before it. Those after it move along. */
export function moved(keyframes: Keyframe[], index: number, at: number): Keyframe[] {
  const shift = Math.max(at, keyframes[index - 1].at + LEAST) - keyframes[index].at;
  return keyframes.map((keyframe, i) => (i < index ? keyframe : { ...keyframe, at: rounded(keyframe.at + shift) }));
}

/** Scale the path to a duration. */
export function lasting(keyframes: Keyframe[], seconds: number): Keyframe[] {
  const now = keyframes.at(-1)?.at ?? 0;
  if (now === 0) return keyframes;
  const factor = Math.max(seconds, LEAST * (keyframes.length - 1)) / now;
  return keyframes.map((keyframe, i) => ({ ...keyframe, at: i === 0 ? 0 : keyframe.at * factor }));
}

/** Return evenly spaced keyframes through views while the reel plays once, slower if the moves would be too fast. */
export function throughViews(viewmats: number[][], begin: number, end: number): Keyframe[] {
  const legs = viewmats.length - 1;
  const seconds = Math.max(end - begin, LEAST, legs * STEP);
  return viewmats.map((viewmat, i) => ({
    at: rounded((i / Math.max(legs, 1)) * seconds),
    time: begin + (i / Math.max(legs, 1)) * (end - begin),
    viewmat,
  }));
}

function rounded(seconds: number): number {
  return Math.round(seconds * 1000) / 1000;
}

const MARKUP = `<section class="sheet path-panel" aria-label="Camera path">
  <header><h2><button type="button" class="fold" aria-expanded="true">Camera path</button></h2><button type="button" class="close" aria-label="Close the camera path">${CLOSE}</button></header>
  <div class="row">
    <button type="button" class="add">Add this view</button>
    <button type="button" class="cameras">Through the cameras</button>
  </div>
  <p class="empty">Go to a view and a time, and add it; then the next. The camera moves smoothly from one to another.</p>
  <ol></ol>
  <div class="row whole">
    <label>Seconds<input type="number" class="seconds" min="0.1" step="0.5" /></label>
    <label>Loop<input type="checkbox" role="switch" class="loop" /></label>
  </div>
  <div class="row">
    <button type="button" class="play"></button>
    <button type="button" class="back" title="Add the first view at the end">Return</button>
    <button type="button" class="save">Save</button>
    <button type="button" class="load">Load</button>
    <input type="file" class="file" accept=".json,application/json" hidden />
  </div>
  <p class="words" role="status"></p>
</section>`;

const ITEM = `<li>
  <button type="button" class="go"></button>
  <label>at<input type="number" min="0" step="0.1" /></label>
  <button type="button" class="set">Set</button>
  <button type="button" class="remove">${CLOSE}</button>
</li>`;

/** The part of the element that the panel needs. */
export interface PathHost extends HTMLElement {
  readonly player: Player;
  readonly pathPlayer: PathPlayer;
  /** Throws `ReelError` for an invalid path. */
  path: PathFile | null;
}

/** The panel of one element. */
export class PathPanel {
  readonly box: HTMLElement;
  private readonly drawing = new PathDrawing();
  private readonly life = new AbortController();
  private drawn = "";
  private frame = 0;

  /** closed: called when the panel closes. */
  constructor(
    private readonly host: PathHost,
    root: ShadowRoot,
    private readonly closed: () => void,
  ) {
    const { signal } = this.life;
    adoptStyles(root, fields);
    adoptStyles(root, styles);
    this.box = elementOf(MARKUP, host.player.words);
    this.box.dir = directionOf(host.player.language);
    foldByHeader(this.box);
    root.append(this.drawing.box, this.box);
    this.listen(signal);
    this.update();
    this.redraw();
    this.find(".add").focus({ preventScroll: true });
  }

  close(): void {
    this.life.abort();
    cancelAnimationFrame(this.frame);
    this.box.remove();
    this.drawing.box.remove();
    this.closed();
  }

  private listen(signal: AbortSignal): void {
    const { host, player } = this;
    const click = (name: string, act: () => void): void => void (this.find(name).onclick = act);
    click(".close", () => this.close());
    click(".add", () => this.edit((keyframes) => appended(keyframes, player.currentTime, this.viewmat)));
    click(".cameras", () => this.edit(() => this.throughCameras()));
    click(".back", () => this.edit((keyframes) => appended(keyframes, keyframes.at(-1)!.time, keyframes[0].viewmat)));
    click(".play", () => this.toggle());
    click(".save", () => save(JSON.stringify(host.path, null, 1)));
    click(".load", () => this.find(".file").click());
    const file = this.find<HTMLInputElement>(".file");
    file.onchange = () => {
      const [chosen] = file.files!;
      file.value = "";
      if (chosen) void this.load(chosen);
    };
    this.find<HTMLInputElement>(".seconds").onchange = ({ target }) =>
      this.edit((keyframes) => lasting(keyframes, Number((target as HTMLInputElement).value)));
    this.find(".loop").onchange = () => this.edit((keyframes) => keyframes);
    this.box.addEventListener("keydown", (event) => this.key(event));
    host.addEventListener("dragover", (event) => void (holdsFiles(event) && event.preventDefault()), {
      signal,
      capture: true,
    });
    host.addEventListener("drop", (event) => this.drop(event), { signal, capture: true });
    player.addEventListener("pathchange", () => this.update(), { signal });
    player.addEventListener("emptied", () => this.close(), { signal });
  }

  private get player(): Player {
    return this.host.player;
  }

  private get viewmat(): number[] {
    return this.player.camera!.viewmat;
  }

  private find<T extends HTMLElement>(name: string): T {
    return this.box.querySelector<T>(name)!;
  }

  private edit(change: (keyframes: Keyframe[]) => Keyframe[]): void {
    if (!this.player.camera) return;
    const keyframes = change([...(this.host.path?.keyframes ?? [])]);
    const loop = this.find<HTMLInputElement>(".loop").checked;
    this.say("");
    try {
      this.host.path = keyframes.length > 0 ? { format: "splatreel-path", version: 1, loop, keyframes } : null;
    } catch (error) {
      this.say(messageOf(error));
      this.update();
    }
  }

  private throughCameras(): Keyframe[] {
    const { camera, cameras } = this.player.manifest!;
    return throughViews(
      nearestFirst(
        camera.viewmat,
        cameras.map(({ viewmat }) => viewmat),
      ),
      this.player.earliest,
      this.player.duration,
    );
  }

  private toggle(): void {
    const { pathPlayer } = this.host;
    if (pathPlayer.playing) pathPlayer.stop();
    else pathPlayer.play().catch((error) => this.say(messageOf(error)));
  }

  private async load(file: File): Promise<void> {
    try {
      this.host.path = JSON.parse(await file.text()) as PathFile;
      this.say(this.player.words("{0} is loaded", file.name));
    } catch (error) {
      this.say(this.player.words("{0} cannot be loaded. {1}", file.name, messageOf(error)));
    }
  }

  /** Load a dropped path. Other files are left to the player. */
  private drop(event: DragEvent): void {
    const file = [...(event.dataTransfer?.files ?? [])].find(({ name }) => /\.json$/i.test(name));
    if (!file || event.dataTransfer!.files.length > 1) return;
    event.preventDefault();
    event.stopPropagation();
    void this.load(file);
  }

  private key(event: KeyboardEvent): void {
    const typing = event.target instanceof HTMLInputElement && event.target.type === "number";
    if (event.key === "Escape") {
      event.preventDefault();
      this.close();
    }
    if (typing || event.key === "Escape") event.stopPropagation();
  }

  private update(): void {
    const { path, pathPlayer } = this.host;
    const keyframes = path?.keyframes ?? [];
    this.find(".empty").hidden = keyframes.length > 0;
    this.find(".cameras").hidden = (this.player.manifest?.cameras.length ?? 0) < 2;
    for (const name of [".whole", ".save"]) this.find(name).hidden = keyframes.length === 0;
    this.find(".play").hidden = keyframes.length < 2;
    this.find(".play").ariaLabel = pathPlayer.playing ? null : this.player.words("Play the path"); // the bar has a button "Play"
    this.find(".back").hidden = keyframes.length < 2;
    this.find(".play").replaceChildren(
      elementOf(pathPlayer.playing ? PAUSE : PLAY),
      this.player.words(pathPlayer.playing ? "Stop" : "Play"),
    );
    this.find<HTMLInputElement>(".seconds").value = String(Number((keyframes.at(-1)?.at ?? 0).toFixed(2)));
    this.find<HTMLInputElement>(".loop").checked = path?.loop ?? false;
    this.find("ol").replaceChildren(...keyframes.map((keyframe, i) => this.item(keyframe, i)));
    this.drawn = "";
  }

  private item({ at, time, viewmat }: Keyframe, index: number): HTMLElement {
    const t = this.player.words;
    const item = elementOf(ITEM, t);
    const part = <T extends HTMLElement>(name: string, label: string): T => {
      const found = item.querySelector<T>(name)!;
      found.ariaLabel = label;
      return found;
    };
    const number = index + 1;
    const go = part(".go", t("Go to keyframe {0}, {1} s of the reel", number, time.toFixed(1)));
    go.textContent = `${number} · ${time.toFixed(1)} s`;
    go.onclick = () => this.goTo(time, viewmat);
    const input = part<HTMLInputElement>("input", t("Seconds of keyframe {0}", number));
    [input.value, input.disabled] = [String(Number(at.toFixed(2))), index === 0];
    input.onchange = () => this.edit((keyframes) => moved(keyframes, index, Number(input.value)));
    part(".set", t("Set keyframe {0} to this view and time", number)).onclick = () =>
      this.edit((keyframes) =>
        keyframes.map((keyframe, i) =>
          i === index ? { at, time: this.player.currentTime, viewmat: this.viewmat } : keyframe,
        ),
      );
    part(".remove", t("Delete keyframe {0}", number)).onclick = () =>
      this.edit((keyframes) => without(keyframes, index));
    return item;
  }

  private goTo(time: number, viewmat: number[]): void {
    this.host.pathPlayer.stop();
    this.player.pause();
    this.player.camera!.viewmat = viewmat;
    this.player.currentTime = time;
    this.player.invalidate();
  }

  /** Redraw the path when the view changes. It is hidden while it plays. */
  private redraw(): void {
    this.frame = requestAnimationFrame(() => this.redraw());
    const { player, host } = this;
    const {
      camera,
      canvas: { clientWidth, clientHeight },
    } = player;
    if (!camera) return;
    const key = [...camera.viewmat, clientWidth, clientHeight, host.pathPlayer.playing].join();
    if (key === this.drawn) return;
    this.drawn = key;
    this.drawing.draw(host.pathPlayer.playing ? null : host.pathPlayer.path, camera, clientWidth, clientHeight);
  }

  private say(words: string): void {
    this.find(".words").textContent = words;
  }
}

function holdsFiles(event: DragEvent): boolean {
  return event.dataTransfer?.types.includes("Files") ?? false;
}

function save(text: string): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  anchor.download = "camera-path.json";
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}
