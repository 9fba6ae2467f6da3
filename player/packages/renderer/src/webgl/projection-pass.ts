/** First pass: moves each point of a scene to its time, projects and colors it, and writes its splat into the splat target. */
import { eyeOf, type Shown, staticWeights } from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { GpuMemory } from "./gpu-memory";
import { Program } from "./program";
import { MOST_REMOVED, type Cutaway } from "../draw/cutaway";
import type { Scene } from "../draw/scene";
import { coverVertex, projectFragment } from "./shaders";
import { TEXTURE_WIDTH } from "../draw/texture-layout";
import { rowsOf } from "../draw/point-words";
import type { PointTextures } from "./textures";

/** High corner of a box that holds every point. */
const EVERYWHERE = [3e38, 3e38, 3e38];

/** Runs the projection shader over the points of a scene. */
export class ProjectionPass {
  private readonly program: Program;
  private readonly empty: WebGLVertexArrayObject;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly memory: GpuMemory,
  ) {
    this.program = new Program(gl, coverVertex, projectFragment);
    this.empty = gl.createVertexArray();
  }

  /** Wait for the shaders. Throws `ReelError` if the driver rejects them. */
  check(): void {
    this.program.check();
  }

  /** Project a scene. weight: of the current group in a cross-fade. antialias: draw splats thinner than a pixel fainter. cutaway: points left out. */
  run(scene: Scene, weight: number, view: View, antialias: boolean, cutaway: Cutaway | null = null): void {
    const { gl, program, memory } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, memory.target.framebuffer);
    gl.bindVertexArray(this.empty);
    program.use();
    setView(gl, program, view);
    gl.uniform1i(program.at("uAntialias"), antialias ? 1 : 0);
    setCutaway(gl, program, cutaway);
    gl.uniform3fv(program.at("uLight"), memory.lightOf(scene));
    gl.uniform1i(program.at("uMoving"), 0);
    gl.uniform4fv(program.at("uWeights"), staticWeights(weight));
    for (const layer of memory.layersOf(scene)) this.projectFile(layer);
    gl.uniform1i(program.at("uMoving"), 1);
    this.projectGroup(scene.current, weight);
    this.projectGroup(scene.previous, 1 - weight);
  }

  delete(): void {
    this.gl.deleteVertexArray(this.empty);
    this.program.delete();
  }

  private projectGroup(shown: Shown | null, weight: number): void {
    const group = shown && this.memory.group(shown.group);
    if (!shown || !group || !group.range) return;
    const { gl, program } = this;
    const { frames, dxMin, dxStep, dqMin, dqStep, worldly, appearance } = group.range;
    const low = Math.min(Math.floor(shown.frame), frames - 1);
    gl.uniform2i(program.at("uFrames"), low, Math.min(low + 1, frames - 1));
    gl.uniform1f(program.at("uBetween"), shown.frame - low);
    gl.uniform3fv(program.at("uDxMin"), dxMin);
    gl.uniform3fv(program.at("uDxStep"), dxStep);
    gl.uniform4fv(program.at("uDqMin"), dqMin);
    gl.uniform4fv(program.at("uDqStep"), dqStep);
    gl.uniform1i(program.at("uWorldly"), worldly ? 1 : 0);
    gl.uniform4fv(program.at("uAppearanceMin"), appearance?.min ?? [0, 0, 0, 0]);
    gl.uniform4fv(program.at("uAppearanceStep"), appearance?.step ?? [0, 0, 0, 0]);
    gl.uniform4f(program.at("uWeights"), weight, 0, 0, 0);
    this.projectFile(group);
  }

  /** Run one fragment per point of a file, in its rows of the target. */
  private projectFile(file: PointTextures): void {
    if (file.count === 0) return;
    const { gl, program } = this;
    program.texture("uPoints", 0, gl.TEXTURE_2D_ARRAY, file.points);
    program.texture("uCodebook", 1, gl.TEXTURE_2D, file.codebook);
    program.texture("uFlags", 2, gl.TEXTURE_2D, file.flags);
    program.texture("uDx", 3, gl.TEXTURE_2D_ARRAY, file.dx);
    program.texture("uDq", 4, gl.TEXTURE_2D_ARRAY, file.dq);
    program.texture("uAppearance", 5, gl.TEXTURE_2D_ARRAY, file.appearance);
    gl.uniform1i(program.at("uHasAppearance"), file.appearance ? 1 : 0);
    gl.uniform1i(program.at("uFirstRow"), file.firstRow);
    gl.uniform1i(program.at("uCount"), file.count);
    gl.uniform1i(program.at("uShDegree"), file.shDegree);
    gl.viewport(0, file.firstRow, TEXTURE_WIDTH, rowsOf(file.count));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

function setCutaway(gl: WebGL2RenderingContext, program: Program, cutaway: Cutaway | null): void {
  const removed = cutaway?.removed.slice(0, MOST_REMOVED) ?? [];
  const [low, high] = cutaway?.box ?? [EVERYWHERE.map((value) => -value), EVERYWHERE];
  gl.uniform3fv(program.at("uLow"), low);
  gl.uniform3fv(program.at("uHigh"), high);
  gl.uniform1i(program.at("uRemovals"), removed.length);
  if (removed.length > 0)
    gl.uniform4fv(
      program.at("uRemoved"),
      removed.flatMap(({ center, radius }) => [...center, radius]),
    );
}

/** Set the camera uniforms. The Jacobian is evaluated within 1.3 times the field of view, as in 3DGS. */
function setView(gl: WebGL2RenderingContext, program: Program, view: View): void {
  const { viewmat: m, fx, fy, cx, cy, width, height } = view;
  const marginX = (0.15 * width) / fx;
  const marginY = (0.15 * height) / fy;
  gl.uniformMatrix4fv(program.at("uView"), true, m);
  gl.uniform3fv(program.at("uEye"), eyeOf(m));
  gl.uniform4f(program.at("uLens"), fx, fy, cx, cy);
  gl.uniform4f(
    program.at("uRange"),
    -cx / fx - marginX,
    (width - cx) / fx + marginX,
    -cy / fy - marginY,
    (height - cy) / fy + marginY,
  );
  gl.uniform2f(program.at("uSize"), width, height);
  gl.uniform1f(program.at("uNear"), view.near);
}
