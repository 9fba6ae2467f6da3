/** The panel that crops a reel and marks floaters. It prints the command, or saves the list, of `splatreel edit`. Loaded on demand. */
import { add, cross, eyeOf, groupAt, length, overlapOf, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import { MOST_REMOVED, type Sphere, type View } from "@splatreel/renderer";
import { directionOf, type Words } from "../base/words";
import {
  type Box,
  dragged,
  edgesOf,
  type Face,
  FACES,
  firstBox,
  type Mark,
  marksAt,
  middleOf,
  operationsOf,
  pointAt,
  projected,
} from "./crop-box";
import { lineOf } from "./path-drawing";
import { copyText } from "./copy-text";
import type { Player } from "../player/player";
import styles from "./edit-panel.css";
import fields from "./fields.css";
import { foldByHeader } from "./fold";
import { CLOSE } from "./icons";
import { elementOf } from "./markup";
import panelStyles from "./path-panel.css";
import { placeIn } from "./pointer-controls";
import { adoptStyles } from "./styles";

const SVG = "http://www.w3.org/2000/svg";
/** Radius of a handle in pixels, and points of a circle. */
const HANDLE = 9;
const CIRCLE = 32;

/** SVG overlay of an edit. */
export class EditDrawing {
  readonly box = document.createElementNS(SVG, "svg");
  private readonly lines: SVGPathElement[];
  private readonly handles: SVGCircleElement[];

  /** t: texts. drag: called with a face and the pixels by which its handle was dragged. */
  constructor(
    private readonly t: Words,
    drag: (face: Face, by: [number, number]) => void,
  ) {
    this.box.classList.add("path-drawing", "edit-drawing");
    this.lines = ["under", "curve", "under", "marks"].map((name) => {
      const path = document.createElementNS(SVG, "path");
      path.classList.add(name);
      return path;
    });
    this.handles = FACES.map((face) => this.handle(face, drag));
    this.box.append(...this.lines, ...this.handles);
  }

  /** Draw a box, or none, and marks. */
  draw(box: Box | null, marks: Sphere[], view: View): void {
    this.box.setAttribute("viewBox", `0 0 ${view.width} ${view.height}`);
    const edges = box
      ? edgesOf(box)
          .map((edge) => lineOf(edge, view))
          .join("")
      : "";
    const circles = marks.map((mark) => lineOf(outline(mark, view), view)).join("");
    for (const [i, shape] of [edges, edges, circles, circles].entries()) this.lines[i].setAttribute("d", shape);
    for (const [i, face] of FACES.entries()) {
      const place = box && projected(middleOf(box, face), view);
      this.handles[i].style.display = place ? "" : "none";
      this.handles[i].setAttribute("cx", String(place?.[0] ?? 0));
      this.handles[i].setAttribute("cy", String(place?.[1] ?? 0));
    }
  }

  private handle(face: Face, drag: (face: Face, by: [number, number]) => void): SVGCircleElement {
    const circle = document.createElementNS(SVG, "circle");
    circle.setAttribute("r", String(HANDLE));
    circle.setAttribute("role", "slider");
    circle.setAttribute("tabindex", "0");
    circle.setAttribute(
      "aria-label",
      this.t(face.side === 0 ? "Face of the box: low {0}" : "Face of the box: high {0}", "xyz"[face.axis]),
    );
    let last: [number, number] | null = null;
    circle.onpointerdown = (event) => {
      circle.setPointerCapture(event.pointerId);
      last = [event.clientX, event.clientY];
      event.stopPropagation();
    };
    circle.onpointermove = (event) => {
      if (!last) return;
      const scale = this.box.getBoundingClientRect().width / this.box.viewBox.baseVal.width || 1;
      drag(face, [(event.clientX - last[0]) / scale, (event.clientY - last[1]) / scale]);
      last = [event.clientX, event.clientY];
    };
    circle.onpointerup = circle.onpointercancel = () => void (last = null);
    circle.onkeydown = (event) => {
      const by = { ArrowLeft: [-4, 0], ArrowRight: [4, 0], ArrowUp: [0, -4], ArrowDown: [0, 4] }[event.key];
      if (!by || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      event.stopPropagation();
      drag(face, by as [number, number]);
    };
    return circle;
  }
}

/** Return the outline of a sphere as the viewer sees it. */
function outline({ center, radius }: Sphere, { viewmat: m }: View): Vec3[] {
  const away = subtract(center, eyeOf(m));
  const down = cross(away, [m[0], m[1], m[2]]);
  const across = scale(down, 1 / Math.max(length(down), 1e-12));
  const side = cross(across, away);
  const beside = scale(side, 1 / Math.max(length(side), 1e-12));
  return Array.from({ length: CIRCLE + 1 }, (_, i) => {
    const angle = (2 * Math.PI * i) / CIRCLE;
    return add(center, add(scale(beside, radius * Math.cos(angle)), scale(across, radius * Math.sin(angle))));
  });
}

/** Share of the light that a marked floater absorbs at least. */
const FAINT = 0.15;
/** Radius of a first mark, relative to its distance. */
const SIZE = 0.04;

const MARKUP = `<section class="sheet path-panel" aria-label="Crop and clean">
  <header><h2><button type="button" class="fold" aria-expanded="true">Crop and clean</button></h2><button type="button" class="close" aria-label="Close the editor">${CLOSE}</button></header>
  <div class="row whole">
    <label>Crop to the box<input type="checkbox" role="switch" class="crop" checked /></label>
    <label>Transparent<input type="checkbox" role="switch" class="transparent" /></label>
  </div>
  <fieldset class="corners"><legend>Box</legend></fieldset>
  <div class="row">
    <button type="button" class="mark" aria-pressed="false">Mark floaters</button>
    <button type="button" class="before" aria-pressed="false">Before</button>
  </div>
  <p class="empty">Drag the handles of the box. Mark floaters by clicks or strokes on the picture.</p>
  <ol></ol>
  <label for="edit-command">Command</label>
  <textarea id="edit-command" class="command" dir="ltr" rows="3" readonly spellcheck="false"></textarea>
  <div class="row">
    <button type="button" class="copy">Copy</button>
    <button type="button" class="save">Save the list</button>
  </div>
  <p class="words" role="status"></p>
</section>`;

const ITEM = `<li>
  <label class="size">Radius<input type="number" min="0" step="any" /></label>
  <button type="button" class="here" aria-pressed="false">Only now</button>
  <button type="button" class="remove">${CLOSE}</button>
</li>`;

/** The panel of one element. */
export class EditPanel {
  readonly box: HTMLElement;
  private readonly drawing: EditDrawing;
  private readonly life = new AbortController();
  private crop: Box;
  private marks: Mark[] = [];
  private marking = false;
  private before = false;
  private stroke: Vec3 | null = null;
  private frame = 0;
  private drawn = "";
  private stage: Player["stage"] = null;
  private readonly wasTransparent: boolean;

  /** closed: called when the panel closes. */
  constructor(
    private readonly player: Player,
    root: ShadowRoot,
    private readonly closed: () => void,
  ) {
    const { bounds, camera, presentation, transparent } = player.manifest!;
    const focus = presentation.limits?.focus ?? scale(add(bounds[0], bounds[1]), 0.5);
    this.crop = firstBox(bounds, focus, eyeOf(camera.viewmat));
    this.wasTransparent = player.transparent && !transparent;
    this.box = elementOf(MARKUP, player.words);
    this.box.dir = directionOf(player.language);
    this.drawing = new EditDrawing(player.words, (face, by) => this.drag(face, by));
    adoptStyles(root, fields);
    adoptStyles(root, panelStyles);
    adoptStyles(root, styles);
    foldByHeader(this.box);
    root.append(this.drawing.box, this.box);
    this.find(".corners").append(...FACES.map((face) => this.corner(face)));
    this.listen();
    this.update();
    this.redraw();
    this.find(".mark").focus({ preventScroll: true });
  }

  close(): void {
    this.life.abort();
    cancelAnimationFrame(this.frame);
    if (this.player.stage) this.player.stage.cutaway = null;
    this.player.transparent = this.wasTransparent;
    this.box.remove();
    this.drawing.box.remove();
    this.closed();
  }

  /** Operations of the edit, as the command and the list have them. */
  get operations(): string[] {
    return operationsOf(this.checked(".crop") ? this.crop : null, this.marks, this.checked(".transparent"));
  }

  private listen(): void {
    const { signal } = this.life;
    const click = (name: string, act: () => void): void => void (this.find(name).onclick = act);
    click(".close", () => this.close());
    click(".mark", () => this.press(".mark", (this.marking = !this.marking)));
    click(".before", () => this.press(".before", (this.before = !this.before)));
    click(".copy", () => void this.copy());
    click(".save", () => this.save());
    for (const name of [".crop", ".transparent"]) this.find(name).onchange = () => this.update();
    this.box.addEventListener("keydown", (event) => this.key(event));
    const surface = this.drawing.box;
    surface.addEventListener("pointerdown", (event) => this.begin(event), { signal });
    surface.addEventListener("pointermove", (event) => this.stroke && this.brush(event), { signal });
    for (const name of ["pointerup", "pointercancel"])
      surface.addEventListener(name, () => void (this.stroke = null), { signal });
    this.player.addEventListener("emptied", () => this.close(), { signal });
  }

  private find<T extends HTMLElement>(name: string): T {
    return this.box.querySelector<T>(name)!;
  }

  private checked(name: string): boolean {
    return this.find<HTMLInputElement>(name).checked;
  }

  private press(name: string, on: boolean): void {
    this.find(name).setAttribute("aria-pressed", String(on));
    this.find(name).classList.toggle("on", on);
    this.drawing.box.classList.toggle("marking", this.marking);
    this.update();
  }

  /** View in CSS pixels. */
  private get view(): View {
    const { camera, canvas } = this.player;
    return camera!.view(canvas.clientWidth, canvas.clientHeight);
  }

  private drag(face: Face, by: [number, number]): void {
    this.crop = dragged(this.crop, face, by, this.view);
    this.update();
  }

  private begin(event: PointerEvent): void {
    if (!this.marking || event.button !== 0) return;
    this.drawing.box.setPointerCapture(event.pointerId);
    this.player.pause();
    this.brush(event);
  }

  /** Mark the place under the pointer, unless the stroke has marked it. */
  private brush(event: PointerEvent): void {
    const { stage, canvas, camera } = this.player;
    if (!stage?.view || !camera) return;
    const pixel = placeIn(canvas, event);
    const ratio = stage.view.width / canvas.clientWidth;
    const depth = stage.depthAt(pixel[0] * ratio, pixel[1] * ratio, FAINT);
    if (depth === null) return this.say(this.player.words("Nothing is drawn there"));
    const center = pointAt(pixel, depth, this.view);
    const radius = this.marks.at(-1)?.radius ?? Number((SIZE * depth).toPrecision(2));
    if (this.stroke && length(subtract(center, this.stroke)) < radius) return;
    this.stroke = center;
    if (this.marks.length >= MOST_REMOVED)
      return this.say(this.player.words("An edit has at most {0} marks here; add more in the list", MOST_REMOVED));
    this.marks.push({ center, radius, range: null });
    this.say("");
    this.update();
  }

  /** Frames that show only the present group. */
  private get range(): [number, number] {
    const { manifest, currentTime } = this.player;
    const { fps, groups, frames } = manifest!;
    const number = groupAt(manifest!, currentTime * fps);
    const end = groups[number + 1]?.firstFrame ?? frames;
    return [
      Math.min(groups[number].firstFrame + (groups[number - 1] ? overlapOf(manifest!, number) : 0), end - 1),
      end,
    ];
  }

  private get command(): string {
    const quoted = this.operations.map((text) => (/^[\w=:,.@+-]+$/.test(text) ? text : `'${text}'`));
    return ["splatreel edit REEL", ...quoted, "--out EDITED"].join(" ");
  }

  private async copy(): Promise<void> {
    const done = await copyText(this.find<HTMLTextAreaElement>(".command"));
    this.say(
      this.player.words(
        done ? "Copied. Replace REEL by its folder" : "Selected: copy it with the keyboard or the browser's menu",
      ),
    );
  }

  private save(): void {
    const list = JSON.stringify({ format: "splatreel-edit", version: 1, operations: this.operations }, null, 1);
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(new Blob([list], { type: "application/json" }));
    anchor.download = "edits.json";
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
    this.say(this.player.words("Saved. Use it with {0}", "splatreel edit REEL --list edits.json --out EDITED"));
  }

  private key(event: KeyboardEvent): void {
    if (event.key === "Escape") {
      event.preventDefault();
      this.close();
    }
    if (
      event.target instanceof HTMLInputElement ||
      event.target instanceof HTMLTextAreaElement ||
      event.key === "Escape"
    )
      event.stopPropagation();
  }

  private update(): void {
    const { operations } = this;
    this.player.transparent = this.wasTransparent || (this.checked(".transparent") && !this.before);
    this.find(".empty").hidden = this.marks.length > 0;
    for (const name of [".copy", ".save"]) this.find<HTMLButtonElement>(name).disabled = operations.length === 0;
    this.find(".corners").hidden = !this.checked(".crop");
    for (const [i, input] of this.box.querySelectorAll<HTMLInputElement>(".corners input").entries())
      input.value = String(Number(this.crop[FACES[i].side][FACES[i].axis].toPrecision(4)));
    this.find<HTMLTextAreaElement>(".command").value = operations.length > 0 ? this.command : "";
    if (this.find("ol").childElementCount !== this.marks.length) this.list();
    this.drawn = "";
  }

  /** Return the input of a face of the box. */
  private corner({ axis, side }: Face): HTMLElement {
    const input = elementOf<HTMLInputElement>(`<input type="number" step="any" dir="ltr" />`);
    input.ariaLabel = this.player.words(side === 0 ? "Low {0} of the box" : "High {0} of the box", "xyz"[axis]);
    input.onchange = () => {
      const value = Number(input.value);
      const fits = side === 0 ? value < this.crop[1][axis] : value > this.crop[0][axis];
      if (input.value !== "" && fits) this.crop[side][axis] = value;
      else this.say(this.player.words("The low side of the box must be below the high side"));
      this.update();
    };
    return input;
  }

  private list(): void {
    this.find("ol").replaceChildren(...this.marks.map((mark, i) => this.item(mark, i + 1)));
  }

  private item(mark: Mark, number: number): HTMLElement {
    const t = this.player.words;
    const item = elementOf(ITEM, t);
    const input = item.querySelector("input")!;
    input.ariaLabel = t("Radius of mark {0}", number);
    input.value = String(Number(mark.radius.toPrecision(4)));
    input.onchange = () => {
      if (Number(input.value) > 0) mark.radius = Number(input.value);
      this.update();
    };
    const here = item.querySelector<HTMLElement>(".here")!;
    here.title = t("Remove it only in the group of frames that is shown now");
    here.onclick = () => {
      mark.range = mark.range ? null : this.range;
      here.setAttribute("aria-pressed", String(mark.range !== null));
      here.classList.toggle("on", mark.range !== null);
      this.update();
    };
    const remove = item.querySelector<HTMLElement>(".remove")!;
    remove.ariaLabel = t("Delete mark {0}", number);
    remove.onclick = () => {
      this.marks = this.marks.filter((other) => other !== mark);
      this.update();
    };
    return item;
  }

  /** Redraw the overlay and the preview when the view, the time or the edit changes. */
  private redraw(): void {
    this.frame = requestAnimationFrame(() => this.redraw());
    const { player } = this;
    const {
      camera,
      stage,
      canvas: { clientWidth, clientHeight },
      manifest,
    } = player;
    if (!camera || !stage || !manifest) return;
    if (stage !== this.stage) [this.stage, this.drawn] = [stage, ""]; // a reel that rested has a new one
    const shown = marksAt(this.marks, player.currentTime * manifest.fps);
    const key = [...camera.viewmat, clientWidth, clientHeight, shown.length].join();
    if (key === this.drawn) return;
    this.drawn = key;
    const box = this.checked(".crop") ? this.crop : null;
    this.drawing.draw(box, shown, this.view);
    stage.cutaway = this.before ? null : { box, removed: shown };
  }

  private say(words: string): void {
    this.find(".words").textContent = words;
  }
}
