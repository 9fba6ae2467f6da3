/** A way through the cameras of a capture and back, without a stop. */
import { add, length, scale, subtract, type Vec3 } from "./matrix";
import { between, type CameraState } from "./pose";

/** Seconds from one camera to the next. */
const LEG = 2;

export class Flight {
  private readonly stops: CameraState[];

  /** Begins at `start` and always takes the nearest camera that it has not seen. */
  constructor(start: CameraState, cameras: CameraState[]) {
    const left = [...cameras];
    this.stops = [start];
    while (left.length > 0) {
      const here = this.stops.at(-1)!.eye;
      const distances = left.map(({ eye }) => length(subtract(eye, here)));
      this.stops.push(...left.splice(distances.indexOf(Math.min(...distances)), 1));
    }
  }

  /** Where it is after some seconds; `cut`: from one camera to the next without a move. */
  at(seconds: number, cut = false): CameraState {
    const { stops } = this;
    const last = stops.length - 1;
    const along = (seconds / LEG) % (2 * last);
    const place = Math.min(along < last ? along : 2 * last - along, last - 1e-6);
    const leg = Math.floor(place);
    const t = cut ? 0 : place - leg;
    const eyes = [leg - 1, leg, leg + 1, leg + 2].map((i) => stops[Math.min(Math.max(i, 0), last)].eye);
    return { ...between(stops[leg], stops[leg + 1], t), eye: spline(eyes, t) };
  }
}

/** Catmull-Rom: from the second point to the third. */
function spline([a, b, c, d]: Vec3[], t: number): Vec3 {
  const weights = [-t + 2 * t * t - t ** 3, 2 - 5 * t * t + 3 * t ** 3, t + 4 * t * t - 3 * t ** 3, -t * t + t ** 3];
  return [a, b, c, d].reduce((sum, point, i) => add(sum, scale(point, weights[i] / 2)), [0, 0, 0] as Vec3);
}
