/** Shader programs, compiled in the background and checked before use. */
import { PLAIN, ReelError } from "@splatreel/decoder/internal";

/** A vertex and a fragment shader. */
export class Program {
  private readonly program: WebGLProgram;
  private readonly stages: WebGLShader[];
  private readonly locations = new Map<string, WebGLUniformLocation | null>();

  /** Start to compile. Drivers compile in the background until the result is requested. */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    vertex: string,
    fragment: string,
  ) {
    this.program = gl.createProgram();
    this.stages = [compile(gl, gl.VERTEX_SHADER, vertex), compile(gl, gl.FRAGMENT_SHADER, fragment)];
    for (const stage of this.stages) gl.attachShader(this.program, stage);
    gl.linkProgram(this.program);
  }

  /** Wait for the compiler. Throws `ReelError` if the driver rejects the shaders. */
  check(): void {
    const { gl, program, stages } = this;
    if (gl.getProgramParameter(program, gl.LINK_STATUS) || gl.isContextLost())
      return stages.forEach((stage) => gl.deleteShader(stage));
    const why = [...stages.map((stage) => gl.getShaderInfoLog(stage)), gl.getProgramInfoLog(program)]
      .filter(Boolean)
      .join(" ");
    throw new ReelError(`This device's graphics driver rejects the player's shaders: ${why}`, { plain: PLAIN.device });
  }

  use(): void {
    this.gl.useProgram(this.program);
  }

  at(name: string): WebGLUniformLocation | null {
    let location = this.locations.get(name);
    if (location === undefined) this.locations.set(name, (location = this.gl.getUniformLocation(this.program, name)));
    return location;
  }

  attribute(name: string): number {
    return this.gl.getAttribLocation(this.program, name);
  }

  texture(name: string, unit: number, target: number, texture: WebGLTexture | null): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, texture);
    gl.uniform1i(this.at(name), unit);
  }

  delete(): void {
    this.gl.deleteProgram(this.program);
  }
}

function compile(gl: WebGL2RenderingContext, type: number, source: string): WebGLShader {
  const shader = gl.createShader(type)!;
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  return shader;
}
