/** Walking through the scene: mouse look by pointer lock, a stick and drags on touch screens, keys as elsewhere. This part is loaded on demand. */
import { turnOf } from "../camera/pose";
import { Walker } from "../camera/walker";
import type { Player } from "../player/player";
import { CLOSE } from "./icons";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";
import styles from "./walk-mode.css";

/** Radians per pixel of the mouse and of a finger. */
const MOUSE = 0.0022;
const FINGER = 0.005;
/** Maximum pixels of one event, since browsers report jumps when they lock the pointer. */
const JUMP = 200;
/** Maximum pixels of a tap. */
const TAP = 8;

const MARKUP = `<div class="walk" role="group" aria-label="Walk mode">
  <div class="stick" aria-hidden="true"><i></i></div>
  <button type="button" class="leave" aria-label="Leave walk mode" title="Leave walk mode (g)">${CLOSE}</button>
</div>`;

/** The walk of one player, until it is closed. */
export class WalkMode {
  private readonly box: HTMLElement;
  private readonly stick: HTMLElement;
  private readonly walker: Walker;
  private readonly life = new AbortController();
  /** Pointers that look around: last position, and pixels moved. */
  private readonly looking = new Map<number, { x: number; y: number; way: number }>();
  private locked = false;

  /** controls: the element of the controls, which stay above. closed: called at the end. */
  constructor(
    root: ShadowRoot,
    controls: HTMLElement,
    private readonly player: Player,
    say: (words: string) => void,
    private readonly closed: () => void,
  ) {
    const { canvas, words } = player;
    this.box = elementOf(MARKUP, words);
    this.stick = this.box.querySelector(".stick")!;
    this.walker = new Walker(player.manifest!, matchMedia("(prefers-reduced-motion: reduce)").matches);
    player.camera!.driver = this.walker;
    adoptStyles(root, styles);
    controls.before(this.box);
    this.listen(root);
    const touch = matchMedia("(pointer: coarse)").matches;
    if (!touch) this.lock();
    say(touch ? "Left thumb walks, right thumb looks" : "W A S D walks, the mouse looks, Esc leaves");
    canvas.focus({ preventScroll: true });
  }

  /** Leave. The view stays, and orbits about what it shows. */
  close(): void {
    if (this.life.signal.aborted) return;
    this.life.abort();
    if (this.locked) document.exitPointerLock();
    const { camera, stage } = this.player;
    this.box.remove();
    if (camera) {
      camera.driver = null;
      const { view } = stage ?? {};
      const distance =
        (view && !stage!.lost && stage!.depthAt(view.width / 2, view.height / 2)) || camera.state.distance;
      camera.state = { ...camera.state, distance, turn: turnOf(camera.viewmat) };
    }
    this.closed();
  }

  private listen(root: ShadowRoot): void {
    const {
      box,
      stick,
      life: { signal },
    } = this;
    box.querySelector<HTMLElement>(".leave")!.onclick = (event) => {
      event.stopPropagation();
      this.close();
    };
    box.addEventListener("pointerdown", (event) => this.press(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"] as const)
      box.addEventListener(name, (event) => this.release(event));
    for (const name of ["pointerdown", "pointermove"] as const)
      stick.addEventListener(name, (event) => this.push(event));
    for (const name of ["pointerup", "pointercancel"] as const) stick.addEventListener(name, () => this.deflect(0, 0));
    box.addEventListener("contextmenu", (event) => event.preventDefault());
    document.addEventListener(
      "pointerlockchange",
      () => {
        const was = this.locked;
        this.locked = root.pointerLockElement === box;
        if (was && !this.locked) this.close();
      },
      { signal },
    );
    for (const name of ["emptied", "loadstart", "error"])
      this.player.addEventListener(name, () => this.close(), { signal });
  }

  /** Hide the pointer, so that the mouse looks around without an edge. If the browser refuses, drags look around. */
  private lock(): void {
    void Promise.resolve(this.box.requestPointerLock?.()).catch(() => undefined);
  }

  private press(event: PointerEvent): void {
    if (this.locked || event.target !== this.box) return;
    this.looking.set(event.pointerId, { x: event.clientX, y: event.clientY, way: 0 });
    this.box.setPointerCapture(event.pointerId);
  }

  private move(event: PointerEvent): void {
    if (this.locked) {
      event.stopPropagation(); // the controls would stay in sight
      const [x, y] = [event.movementX, event.movementY].map((by) => Math.min(Math.max(by, -JUMP), JUMP) * MOUSE);
      return this.walker.look(x, y);
    }
    const last = this.looking.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    [last.x, last.y, last.way] = [event.clientX, event.clientY, last.way + Math.hypot(dx, dy)];
    this.walker.look(dx * FINGER, dy * FINGER);
  }

  /** End a look. A tap shows or hides the controls; a click locks the pointer. */
  private release(event: PointerEvent): void {
    const last = this.looking.get(event.pointerId);
    this.looking.delete(event.pointerId);
    if (!last || last.way > TAP || event.type === "pointercancel") return;
    if (event.pointerType === "touch") this.player.canvas.click();
    else this.lock();
  }

  /** Follow the thumb on the stick. */
  private push(event: PointerEvent): void {
    event.stopPropagation();
    const { stick } = this;
    if (event.type === "pointerdown") stick.setPointerCapture(event.pointerId);
    else if (!stick.hasPointerCapture(event.pointerId)) return;
    const { left, top, width, height } = stick.getBoundingClientRect();
    const [x, y] = [(2 * (event.clientX - left)) / width - 1, (2 * (event.clientY - top)) / height - 1];
    const size = Math.max(Math.hypot(x, y), 1);
    this.deflect(x / size, y / size);
  }

  private deflect(x: number, y: number): void {
    this.walker.stick = [x, -y];
    const knob = this.stick.firstElementChild as HTMLElement;
    knob.style.translate = `${40 * x}% ${40 * y}%`;
  }
}
