/** Second pass: draws the splats of the target as quads, far to near. */
import type { Eye } from "../draw/eye";
import { Program } from "./program";
import { splatFragment, splatVertexOf } from "./shaders";
import { integerTexture, type SplatTarget } from "./splat-target";
import { TEXTURE_WIDTH } from "../draw/texture-layout";
import { rowsOf } from "../draw/point-words";

/** Vertex and fragment shader of the pass. */
export type SplatShaders = [vertex: string, fragment: string];

/** Draws the splats in the present order. */
export class SplatPass {
  private readonly program: Program;
  private readonly quads: WebGLVertexArrayObject;
  private readonly corners: WebGLBuffer;
  private order: WebGLTexture | null = null;
  /** True if the alpha of the image counts. Otherwise it stays 1, exactly. */
  transparent = true;
  private orderRows = 0;
  private points = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly target: SplatTarget,
    shaders: SplatShaders = [splatVertexOf("0.0"), splatFragment],
  ) {
    this.program = new Program(gl, ...shaders);
    this.quads = gl.createVertexArray();
    this.corners = gl.createBuffer();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, rowOfQuads(), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  /** Wait for the shaders. Throws `ReelError` if the driver rejects them. */
  check(): void {
    this.program.check();
  }

  /** Number of points in the order. */
  get count(): number {
    return this.points;
  }

  /** Upload the order of the sort worker: whole rows, of which `count` entries are points. */
  setOrder(order: Uint32Array, count: number): void {
    const { gl } = this;
    const rows = rowsOf(count);
    if (rows > this.orderRows) {
      gl.deleteTexture(this.order);
      this.orderRows = Math.max(rows, Math.ceil(1.25 * this.orderRows));
      this.order = integerTexture(gl, gl.R32UI, this.orderRows);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.order);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    this.points = count;
  }

  /** Draw into the place of an eye. prepare: sets further uniforms. */
  run({ framebuffer, x, y, view }: Eye, prepare?: (program: Program) => void): void {
    const { gl, program } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, view.width, view.height);
    program.use();
    program.texture("uShape", 0, gl.TEXTURE_2D, this.target.shape);
    program.texture("uColor", 1, gl.TEXTURE_2D, this.target.color);
    program.texture("uOrder", 2, gl.TEXTURE_2D, this.order);
    gl.uniform2f(program.at("uSize"), view.width, view.height);
    prepare?.(program);
    gl.bindVertexArray(this.quads);
    gl.enable(gl.BLEND);
    if (this.transparent) gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    else gl.blendFuncSeparate(gl.ONE, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
    // Each instance draws a row of the order, since instances of a single quad are slow on many devices.
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * TEXTURE_WIDTH, gl.UNSIGNED_SHORT, 0, rowsOf(this.points));
    gl.disable(gl.BLEND);
  }

  delete(): void {
    this.gl.deleteTexture(this.order);
    this.gl.deleteVertexArray(this.quads);
    this.gl.deleteBuffer(this.corners);
    this.program.delete();
  }
}

/** Return the indices of two triangles per splat, for a row of the order. */
function rowOfQuads(): Uint16Array {
  const indices = new Uint16Array(6 * TEXTURE_WIDTH);
  for (let i = 0; i < TEXTURE_WIDTH; i++)
    indices.set(
      [0, 1, 2, 2, 1, 3].map((corner) => 4 * i + corner),
      6 * i,
    );
  return indices;
}
