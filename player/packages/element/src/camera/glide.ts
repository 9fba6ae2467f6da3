/** Transition of the camera between two poses. */
import { add, scale } from "@splatreel/decoder/internal";
import type { Sight } from "./driver";
import type { Horizon } from "./horizon";

/** Duration of a transition, in seconds. */
const DURATION = 0.5;

/** Moves smoothly from one pose to another. */
export class Glide {
  private at: number;

  /** instant: arrive with the first step. */
  constructor(
    private readonly horizon: Horizon,
    private readonly from: Sight,
    readonly to: Sight,
    instant: boolean,
  ) {
    this.at = instant ? 1 : 0;
  }

  /** True once the last step has arrived. */
  get over(): boolean {
    return this.at === 1;
  }

  /** Return the pose after more seconds. */
  step(seconds: number): Sight {
    const { from, to, horizon } = this;
    this.at = Math.min(this.at + seconds / DURATION, 1);
    const t = this.at * this.at * (3 - 2 * this.at);
    return {
      eye: add(scale(from.eye, 1 - t), scale(to.eye, t)),
      gaze: t < 1 ? horizon.between(from.gaze, to.gaze, t) : to.gaze,
      distance: from.distance * (1 - t) + to.distance * t,
    };
  }
}
