/** Blends the image of the next group over that of the present one, since the points of both would hide each other. */
import type { Eye } from "../draw/eye";
import { Program } from "./program";
import { coverVertex, fadeFragment } from "./shaders";

/** A second image, and the pass that blends it. */
export class CrossFade {
  /** Framebuffer of the second image. */
  readonly framebuffer: WebGLFramebuffer | null;

  private readonly program: Program;
  private readonly empty: WebGLVertexArrayObject | null;
  private picture: WebGLTexture | null = null;
  private size = [0, 0];
  /** True if the alpha of the image counts. Otherwise it stays 1, exactly. */
  transparent = true;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.program = new Program(gl, coverVertex, fadeFragment);
    this.framebuffer = gl.createFramebuffer();
    this.empty = gl.createVertexArray();
  }

  /** Wait for the shaders. Throws `ReelError` if the driver rejects them. */
  check(): void {
    this.program.check();
  }

  /** Clear the second image, resized to width x height, to the present clear color. */
  begin(width: number, height: number): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    if (this.size[0] !== width || this.size[1] !== height) {
      gl.deleteTexture(this.picture);
      this.picture = gl.createTexture();
      this.size = [width, height];
      gl.bindTexture(gl.TEXTURE_2D, this.picture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
    }
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** Blend the image over the view of an eye. */
  blend({ framebuffer, x, y, view }: Eye, weight: number): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, view.width, view.height);
    this.program.use();
    this.program.texture("uPicture", 0, gl.TEXTURE_2D, this.picture);
    gl.uniform2i(this.program.at("uCorner"), x, y);
    gl.bindVertexArray(this.empty);
    gl.enable(gl.BLEND);
    gl.blendColor(0, 0, 0, weight);
    if (this.transparent) gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    else gl.blendFuncSeparate(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA, gl.ZERO, gl.ONE);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }

  delete(): void {
    this.gl.deleteTexture(this.picture);
    this.gl.deleteVertexArray(this.empty);
    this.gl.deleteFramebuffer(this.framebuffer);
    this.program.delete();
  }
}
