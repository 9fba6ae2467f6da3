/** Walking through the scene: mouse look by pointer lock, a stick and drags on touch screens, keys as elsewhere. This part is loaded on demand. */
import { add, cross, length, type Manifest, normalize, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { CameraDriver, Sight } from "../camera/driver";
import { Horizon } from "../camera/horizon";
import { Limits } from "../camera/limits";
import type { Motion } from "../camera/motion";
import { metersPerUnit } from "../camera/scene-size";
import { turnOf } from "../camera/pose";
import type { Player } from "../player/player";
import { CLOSE } from "./icons";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";
import styles from "./walk-mode.css";

/** Walking speed, in meters per second. */
const SPEED = 1.4;
/** Rates at which the speed adapts, and at which a tilt decays and the limits pull, per second. */
const AGILITY = 8;
const PULL = 5;
/** Speed below which the walk ends, relative to the walking speed, and distance that is none, relative to the scene. */
const SLOW = 0.01;
const NEAR = 1e-4;

/** Moves the camera of one reel. */
export class Walker implements CameraDriver {
  /** Deflection of the stick to the right and ahead, each -1 to 1. */
  stick: [number, number] = [0, 0];
  private readonly horizon: Horizon;
  private readonly limits: Limits;
  private readonly up: Vec3;
  /** World units per second. */
  private readonly speed: number;
  /** Angles by which people turned since the last step, in radians. */
  private turned: [yaw: number, pitch: number] = [0, 0];
  private velocity: Vec3 = [0, 0, 0];
  /** True from an input until the walk is at rest within the limits. */
  private walking = false;

  /** calm: no inertia, for people who prefer reduced motion. */
  constructor(
    manifest: Manifest,
    private readonly calm: boolean,
  ) {
    this.up = normalize(manifest.up);
    this.horizon = new Horizon(this.up);
    this.limits = new Limits(manifest);
    this.speed = SPEED / metersPerUnit(manifest);
  }

  /** Turn by angles in radians: positive yaw is to the right, positive pitch down. */
  look(yaw: number, pitch: number): void {
    this.turned = [this.turned[0] + yaw, this.turned[1] + pitch];
  }

  step(sight: Sight, keys: Motion, seconds: number): Sight | null {
    const { horizon, speed, calm } = this;
    const wanted = this.wantedSpeed(sight, keys);
    const [yaw, pitch] = [this.turned[0] + keys.yaw * seconds, this.turned[1] + keys.pitch * seconds];
    this.turned = [0, 0];
    if (length(wanted) > 0 || yaw !== 0 || pitch !== 0) this.walking = true;
    if (!this.walking) return null;
    const part = (rate: number): number => (calm ? 1 : 1 - Math.exp(-rate * seconds));
    this.velocity = add(this.velocity, scale(subtract(wanted, this.velocity), part(AGILITY)));
    const gaze = horizon.righted(horizon.turned(sight.gaze, -yaw, -pitch), part(PULL));
    const free = add(sight.eye, scale(this.velocity, seconds));
    const eye = this.limits.eye(free, part(PULL));
    const rests =
      length(this.velocity) < SLOW * speed &&
      length(wanted) === 0 &&
      length(subtract(eye, free)) < NEAR * this.limits.extent;
    if (rests && horizon.isLevel(gaze)) [this.walking, this.velocity] = [false, [0, 0, 0]];
    return { eye, gaze, distance: sight.distance };
  }

  /** Return the velocity that keys and stick request. It is level, but for the keys up and down. */
  private wantedSpeed({ gaze }: Sight, keys: Motion): Vec3 {
    const { stick, up, speed } = this;
    const ahead = stick[1] + Math.sign(keys.forward);
    const right = stick[0] + Math.sign(keys.right);
    const way = add(
      add(scale(gaze.heading, ahead), scale(cross(gaze.heading, up), right)),
      scale(up, -Math.sign(keys.down)),
    );
    return scale(way, speed / Math.max(length(way), 1));
  }
}

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
