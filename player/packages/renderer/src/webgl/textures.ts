/** GPU textures of the points of one file. */
import { type Gaussians, type Offsets, PLAIN, ReelError } from "@splatreel/decoder/internal";
import {
  ENTRIES_PER_ROW,
  ENTRY_TEXELS,
  POINT_TEXELS,
  packCodebook,
  packFlags,
  packPoints,
  rowsOf,
} from "../draw/point-words";
import { TEXTURE_WIDTH } from "../draw/texture-layout";

/** The part of a group's offsets that stays on the CPU. */
export type OffsetRange = Pick<Offsets, "frames" | "dxMin" | "dxStep" | "dqMin" | "dqStep" | "worldly" | "appearance">;

/** Textures of the points, their codebook, and their offsets. */
export class PointTextures {
  readonly count: number;
  readonly shDegree: number;
  readonly points: WebGLTexture | null = null;
  readonly codebook: WebGLTexture | null = null;
  readonly range: OffsetRange | null = null;
  flags: WebGLTexture | null = null;
  dx: WebGLTexture | null = null;
  dq: WebGLTexture | null = null;
  appearance: WebGLTexture | null = null;

  /** Upload a file. firstRow: first row of its splats in the splat target. */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    readonly firstRow: number,
    points: Gaussians,
    offsets: Offsets | null,
  ) {
    this.count = points.count;
    this.shDegree = points.shDegree;
    if (points.count === 0) return;
    this.points = this.uploadPoints(points);
    if (points.shDegree > 0) this.codebook = this.uploadCodebook(points);
    if (offsets) {
      this.range = offsets;
      this.dx = this.uploadFrames(offsets.dx, offsets.frames, gl.RGBA16UI, gl.UNSIGNED_SHORT);
      this.dq = this.uploadFrames(offsets.dq, offsets.frames, gl.RGBA8UI, gl.UNSIGNED_BYTE);
      if (offsets.appearance)
        this.appearance = this.uploadFrames(offsets.appearance.data, offsets.frames, gl.RGBA8UI, gl.UNSIGNED_BYTE);
    }
  }

  /** Upload the flags [N] of `staticFlags`, for a layer. */
  setFlags(flags: Uint8Array): void {
    if (this.count === 0) return;
    const { gl } = this;
    const rows = rowsOf(this.count);
    if (this.flags === null) {
      this.flags = this.create(gl.TEXTURE_2D);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R8UI, TEXTURE_WIDTH, rows);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.flags);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rows, gl.RED_INTEGER, gl.UNSIGNED_BYTE, packFlags(flags));
  }

  delete(): void {
    for (const texture of [this.points, this.codebook, this.flags, this.dx, this.dq, this.appearance])
      this.gl.deleteTexture(texture);
  }

  private uploadPoints(points: Gaussians): WebGLTexture {
    const { gl } = this;
    const rows = rowsOf(points.count);
    const words = packPoints(points);
    const texture = this.create(gl.TEXTURE_2D_ARRAY);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA32UI, TEXTURE_WIDTH, rows, POINT_TEXELS);
    gl.texSubImage3D(
      gl.TEXTURE_2D_ARRAY,
      0,
      0,
      0,
      0,
      TEXTURE_WIDTH,
      rows,
      POINT_TEXELS,
      gl.RGBA_INTEGER,
      gl.UNSIGNED_INT,
      words,
    );
    return texture;
  }

  private uploadCodebook(points: Gaussians): WebGLTexture {
    const { gl } = this;
    const { values, rows, entries } = packCodebook(points);
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE) as number;
    if (rows > most)
      throw new ReelError(
        `A file of the reel has more view-dependent colors than this device holds (${entries} of ${most * ENTRIES_PER_ROW}).`,
        { plain: PLAIN.device },
      );
    const width = ENTRIES_PER_ROW * ENTRY_TEXELS;
    const texture = this.create(gl.TEXTURE_2D);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, rows);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, rows, gl.RGBA, gl.FLOAT, values);
    return texture;
  }

  /** Upload [T, N, 4] values as one array layer per frame: first the whole rows, then the last one. */
  private uploadFrames(values: Uint16Array | Uint8Array, frames: number, format: number, type: number): WebGLTexture {
    const { gl, count } = this;
    const texture = this.create(gl.TEXTURE_2D_ARRAY);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, format, TEXTURE_WIDTH, rowsOf(count), frames);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const whole = Math.floor(count / TEXTURE_WIDTH);
    const left = count - whole * TEXTURE_WIDTH;
    const part = (t: number, row: number, width: number, rows: number): void => {
      const first = 4 * (t * count + row * TEXTURE_WIDTH);
      const data = values.subarray(first, first + 4 * width * rows);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, row, t, width, rows, 1, gl.RGBA_INTEGER, type, data);
    };
    for (let t = 0; t < frames; t++) {
      if (whole > 0) part(t, 0, TEXTURE_WIDTH, whole);
      if (left > 0) part(t, whole, left, 1);
    }
    return texture;
  }

  private create(target: number): WebGLTexture {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(target, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
    return texture;
  }
}
