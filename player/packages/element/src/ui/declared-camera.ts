/** Camera attributes of an element: `camera-orbit`, `camera-target`, `field-of-view`, bounds and `auto-rotate`. This part is loaded on demand. */
import { messageOf } from "@splatreel/decoder/internal";
import {
  OrbitFrame,
  parseAngle,
  parseFieldOfView,
  parseOrbit,
  parseTarget,
  type Orbit,
} from "../camera/orbit-declaration";
import type { Player } from "../player/player";

const AUTO: Orbit = { theta: null, phi: null, radius: null };
/** Default rotation in radians per second, and seconds of rest before it. */
const SPEED = (12 * Math.PI) / 180;
const DELAY = 3;

/** The camera that the attributes of one element declare. */
export class DeclaredCamera {
  /** Attributes that were reported to be wrong, with their values. */
  private readonly reported = new Set<string>();

  constructor(
    private readonly host: HTMLElement,
    private readonly player: Player,
    signal: AbortSignal,
  ) {
    player.addEventListener("loadedmetadata", () => this.apply(), { signal });
    this.apply();
  }

  /** Apply the attributes to the camera, once the reel has one. The view changes only if people have not moved it. */
  apply(): void {
    const {
      player: { camera, manifest },
    } = this;
    if (!camera || !manifest) return;
    const target = this.read("camera-target", parseTarget, null);
    const orbit = this.read("camera-orbit", parseOrbit, AUTO);
    const frame = new OrbitFrame(manifest, camera.ownState, target);
    camera.fieldOfView = this.read("field-of-view", parseFieldOfView, null);
    const [least, most] = ["min-camera-orbit", "max-camera-orbit"].map((name) => this.read(name, parseOrbit, AUTO));
    camera.bounds =
      least === AUTO && most === AUTO
        ? null
        : this.attempt("min-camera-orbit", () => frame.boundsOf(least, most), null);
    camera.startAt(target || orbit !== AUTO ? frame.stateOf(orbit) : camera.ownState);
    camera.rotate(
      this.host.hasAttribute("auto-rotate")
        ? { speed: this.read("rotation-per-second", (text) => parseAngle(text) ?? SPEED, SPEED), delay: this.delay }
        : null,
    );
    this.player.invalidate();
  }

  private get delay(): number {
    const parse = (text: string): number => {
      const milliseconds = Number(text || NaN);
      if (!(milliseconds >= 0)) throw new Error(`"${text}" is not a time. Write milliseconds, such as 3000`);
      return milliseconds / 1000;
    };
    return this.read("auto-rotate-delay", parse, DELAY);
  }

  /** Return the parsed value of an attribute, or the default if it is missing or wrong. */
  private read<T>(name: string, parse: (text: string) => T, without: T): T {
    const text = this.host.getAttribute(name);
    return text === null ? without : this.attempt(name, () => parse(text), without);
  }

  private attempt<T>(name: string, work: () => T, without: T): T {
    try {
      return work();
    } catch (error) {
      const words = `<splat-reel ${name}>: ${messageOf(error)}. The attribute has no effect.`;
      if (!this.reported.has(words)) console.warn(words);
      this.reported.add(words);
      return without;
    }
  }
}
