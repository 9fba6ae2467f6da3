/** Rings on the floor and rays, drawn over the picture of a headset. */
import { add, cross, length, normalize, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import { Program } from "./program";

/** A ring on the floor around a center, or a ray, in the space of the headset. */
export type Mark = { center: Vec3 } | { from: Vec3; to: Vec3 };

/** An eye: its place in the framebuffer, and its matrices [16], column-major. */
export interface MarkedEye {
  port: { x: number; y: number; width: number; height: number };
  projection: Float32Array;
  inverse: Float32Array;
}

/** Inner and outer radius of a ring, and width of a ray, in meters. */
const RING: [number, number] = [0.12, 0.15];
const RAY = 0.008;
/** Dark edge on both sides, so that marks show on any ground, in meters. */
const EDGE = 0.012;
const SEGMENTS = 48;
const UP: Vec3 = [0, 1, 0];

const VERTEX = `#version 300 es
uniform mat4 uProjection, uView;
in vec3 aPoint;
void main() { gl_Position = uProjection * uView * vec4(aPoint, 1.0); }`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform vec3 uColor;
out vec4 color;
void main() { color = vec4(uColor, 1.0); }`;

/** Draws marks on the context of the player's canvas. */
export class HeadsetMarks {
  private readonly program: Program;
  private readonly points: WebGLVertexArrayObject;
  private readonly buffer: WebGLBuffer;

  /** Throws `ReelError` if the driver rejects the shaders. */
  constructor(private readonly gl: WebGL2RenderingContext) {
    this.program = new Program(gl, VERTEX, FRAGMENT);
    this.program.check();
    this.points = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    gl.bindVertexArray(this.points);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    const at = this.program.attribute("aPoint");
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
  }

  /** Draw marks over the picture. clear: draw them over nothing. */
  draw(framebuffer: WebGLFramebuffer | null, eyes: MarkedEye[], marks: Mark[], clear: boolean): void {
    const { gl, program } = this;
    if (marks.length === 0 && !clear) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.clearColor(0, 0, 0, 0);
    if (clear) gl.clear(gl.COLOR_BUFFER_BIT);
    program.use();
    gl.bindVertexArray(this.points);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const [edge, color] of [
      [EDGE, 0],
      [0, 1],
    ]) {
      const corners = new Float32Array(marks.flatMap((mark) => trianglesOf(mark, edge).flat()));
      gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STREAM_DRAW);
      gl.uniform3f(program.at("uColor"), color, color, color);
      for (const { port, projection, inverse } of eyes) {
        gl.viewport(port.x, port.y, port.width, port.height);
        gl.uniformMatrix4fv(program.at("uProjection"), false, projection);
        gl.uniformMatrix4fv(program.at("uView"), false, inverse);
        gl.drawArrays(gl.TRIANGLES, 0, corners.length / 3);
      }
    }
    gl.bindVertexArray(null);
  }

  delete(): void {
    this.gl.deleteVertexArray(this.points);
    this.gl.deleteBuffer(this.buffer);
    this.program.delete();
  }
}

/** Return the corners of the triangles of a mark, wider by an edge on each side. */
function trianglesOf(mark: Mark, edge: number): Vec3[] {
  if ("center" in mark) {
    const corner = (i: number, radius: number): Vec3 => {
      const angle = (2 * Math.PI * i) / SEGMENTS;
      return add(mark.center, [radius * Math.cos(angle), 0, radius * Math.sin(angle)]);
    };
    const [inner, outer] = [RING[0] - edge, RING[1] + edge];
    return Array.from({ length: SEGMENTS }, (_, i) =>
      quad(corner(i, inner), corner(i, outer), corner(i + 1, inner), corner(i + 1, outer)),
    ).flat();
  }
  const { from, to } = mark;
  const way = subtract(to, from);
  const aside = cross(way, UP);
  const side = scale(length(aside) > 1e-6 ? normalize(aside) : [1, 0, 0], RAY / 2 + edge / 4);
  return quad(subtract(from, side), add(from, side), subtract(to, side), add(to, side));
}

function quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3): Vec3[] {
  return [a, b, c, c, b, d];
}
