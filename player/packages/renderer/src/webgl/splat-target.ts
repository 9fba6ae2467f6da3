/** Textures between the two passes, with one texel per splat: its shape, and its color with depth. */
import { PLAIN, ReelError } from "@splatreel/decoder/internal";
import { TEXTURE_WIDTH } from "../draw/texture-layout";

/** Framebuffer with the two textures. */
export class SplatTarget {
  readonly framebuffer: WebGLFramebuffer;
  private shapes: WebGLTexture | null = null;
  private colors: WebGLTexture | null = null;
  private capacity = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.framebuffer = gl.createFramebuffer();
  }

  get shape(): WebGLTexture | null {
    return this.shapes;
  }

  get color(): WebGLTexture | null {
    return this.colors;
  }

  /** Reserve rows. Each frame rewrites them, so nothing is copied. Throws `ReelError` if the device has no textures of this size. */
  reserve(rows: number): void {
    if (rows <= this.capacity) return;
    const { gl } = this;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE) as number;
    if (rows > most)
      throw new ReelError(
        `The reel has more points than this device draws (${rows * TEXTURE_WIDTH} of ${most * TEXTURE_WIDTH}).`,
        { plain: PLAIN.device },
      );
    this.capacity = Math.min(Math.max(rows, Math.ceil(1.5 * this.capacity)), most);
    for (const texture of [this.shapes, this.colors]) gl.deleteTexture(texture);
    this.shapes = integerTexture(gl, gl.RGBA32UI, this.capacity);
    this.colors = integerTexture(gl, gl.RGBA32UI, this.capacity);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shapes, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, this.colors, 0);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
  }

  /** Read words [rows, 1024, 4] of shape and color back from the GPU. */
  read(firstRow: number, rows: number): [Uint32Array, Uint32Array] {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    const words = (attachment: number): Uint32Array => {
      const result = new Uint32Array(4 * rows * TEXTURE_WIDTH);
      gl.readBuffer(attachment);
      gl.readPixels(0, firstRow, TEXTURE_WIDTH, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, result);
      return result;
    };
    return [words(gl.COLOR_ATTACHMENT0), words(gl.COLOR_ATTACHMENT1)];
  }

  delete(): void {
    const { gl } = this;
    for (const texture of [this.shapes, this.colors]) gl.deleteTexture(texture);
    gl.deleteFramebuffer(this.framebuffer);
  }
}

/** Create a texture of integers, without filtering. */
export function integerTexture(gl: WebGL2RenderingContext, format: number, rows: number): WebGLTexture {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, TEXTURE_WIDTH, rows);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return texture;
}
