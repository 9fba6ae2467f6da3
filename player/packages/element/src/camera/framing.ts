/** Framing of the reel's own camera in pictures of other shapes. */
import type { Camera, Vec3 } from "@splatreel/decoder/internal";
import type { View } from "@splatreel/renderer";

/** Maximum crop of the image to fill a wider screen, and a narrower one, where no camera shows what is above and below the image. */
const CROP = 1.4;
const NARROW_CROP = 4;
/** On a screen that crops more than `CROP`, the offset of the focus, in half widths, above which the first view is centered on it. */
const ASIDE = 0.2;

/** Fields of view for pictures of any size. */
export class Framing {
  /** home: the reel's own camera. near: near plane, in world units. */
  constructor(
    private readonly home: Camera,
    private readonly near: number,
  ) {}

  /** Return the view from a pose [16] for width x height pixels. fieldOfView: vertical, in radians; null for that of the reel. */
  view(viewmat: number[], width: number, height: number, fieldOfView: number | null = null): View {
    const { K, width: w, height: h } = this.home;
    const whole = Math.min(width / w, height / h);
    const filled = Math.max(width / w, height / h);
    const fill = Math.min(filled, (width * h < height * w ? NARROW_CROP : CROP) * whole);
    const zoom = fieldOfView === null ? fill : height / 2 / Math.tan(fieldOfView / 2) / K[4];
    return {
      viewmat,
      fx: K[0] * zoom,
      fy: K[4] * zoom,
      cx: width / 2 + (K[2] - w / 2) * zoom,
      cy: height / 2 + (K[5] - h / 2) * zoom,
      width,
      height,
      near: this.near,
    };
  }

  /**
   * Return where in the image of the reel's camera, 0 to 1 across its width, a narrow screen shall be centered because the focus is
   * there; null for the middle. m: pose [16] of the reel's camera.
   */
  centerOf(m: number[], focus: Vec3, width: number, height: number): number | null {
    const { home } = this;
    const { fx } = this.view(m, width, height);
    const [x, z] = [0, 8].map((i) => m[i] * focus[0] + m[i + 1] * focus[1] + m[i + 2] * focus[2] + m[i + 3]);
    const isWide = home.width * height <= CROP * home.height * width;
    if (isWide || z <= 0 || Math.abs((fx * x) / z) < (ASIDE * width) / 2) return null;
    return ((home.K[0] * x) / z + home.K[2]) / home.width;
  }
}
