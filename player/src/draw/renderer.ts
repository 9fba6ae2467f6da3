/** Draws a reel's points in WebGL2. Knows nothing about time or downloads: it is told what to show. */
import { PLAIN, ReelError } from "../base/errors";
import { eyeOf, type Vec3 } from "../base/matrix";
import type { View } from "../base/view";
import type { DecodedFile } from "../decode/decode-file";
import { lightAt } from "../decode/light";
import { staticFlags, staticWeights, type Shown } from "../reel/timeline";
import { CrossFade } from "./cross-fade";
import type { Eye } from "./eye";
import { hitsAt, middleDepth, type Hit } from "./pick";
import { Program } from "./program";
import { RowAllocator } from "./row-allocator";
import type { Scene } from "./scene";
import { projectFragment, projectVertex, splatFragment, splatVertex } from "./shaders";
import { TEXTURE_WIDTH } from "./texture-layout";
import { PointTextures, rowsOf } from "./textures";

export class Renderer {
  private readonly gl: WebGL2RenderingContext;
  private readonly project: Program;
  private readonly splat: Program;
  private readonly fade: CrossFade;
  private readonly target: WebGLFramebuffer;
  private shape: WebGLTexture | null = null;
  private color: WebGLTexture | null = null;
  private readonly quads: WebGLVertexArrayObject;
  private readonly empty: WebGLVertexArrayObject;
  private readonly corners: WebGLBuffer;
  private order: WebGLTexture | null = null;
  private orderRows = 0;
  private readonly rows = new RowAllocator();
  private capacity = 0;
  private readonly layers: PointTextures[] = [];
  private readonly groups = new Map<number, { textures: PointTextures; alive: Uint8Array; light: Float32Array | null }>();
  private flagsKey = "";
  private last: { scene: Scene; weight: number; view: View } | null = null;
  /** The browser draws without a graphics device. */
  readonly software: boolean;
  /** Splats thinner than a pixel are drawn fainter. */
  private antialias = false;
  /** Red, green and blue where nothing is drawn. */
  private background: Vec3 = [0, 0, 0];
  /** Points in the order. */
  drawn = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new ReelError("This browser or device offers no WebGL 2, which the player draws with.", { plain: PLAIN.device });
    this.gl = gl;
    this.software = isSoftware(gl);
    this.project = new Program(gl, projectVertex, projectFragment);
    this.splat = new Program(gl, splatVertex, splatFragment);
    this.fade = new CrossFade(gl);
    this.target = gl.createFramebuffer();
    this.empty = gl.createVertexArray();
    this.quads = gl.createVertexArray();
    this.corners = gl.createBuffer();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, rowOfQuads(), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  /** Once it is known what is drawn: wait for what the driver still does. Throws `ReelError` where it cannot draw the player's pictures. */
  begin(antialias: boolean, background: Vec3): void {
    [this.antialias, this.background] = [antialias, background];
    this.project.check();
    this.splat.check();
    this.fade.check();
  }

  get lost(): boolean {
    return this.gl.isContextLost();
  }

  /** Upload a layer; returns the index of its first point in the draw order. */
  addLayer(index: number, file: DecodedFile): number {
    const textures = this.upload(file);
    this.layers[index] = textures;
    this.flagsKey = "";
    return textures.firstRow * TEXTURE_WIDTH;
  }

  /** Upload a group; returns the index of its first point in the draw order. */
  addGroup(index: number, file: DecodedFile): number {
    const textures = this.upload(file);
    this.groups.set(index, { textures, alive: file.alive, light: file.light });
    return textures.firstRow * TEXTURE_WIDTH;
  }

  dropGroup(index: number): void {
    const textures = this.groups.get(index)?.textures;
    if (!textures) return;
    this.groups.delete(index);
    this.rows.give(textures.firstRow, rowsOf(textures.count));
    textures.delete();
  }

  /** Whether a scene's groups are in memory. */
  holds(scene: Scene): boolean {
    return [scene.current, scene.previous].every((shown) => shown === null || this.groups.has(shown.group));
  }

  /** Far-to-near order of points, as the sort worker gave it: whole rows, of which `count` entries are points. */
  setOrder(order: Uint32Array, count: number): void {
    const { gl } = this;
    const rows = rowsOf(count);
    if (rows > this.orderRows) {
      gl.deleteTexture(this.order);
      this.orderRows = Math.max(rows, Math.ceil(1.25 * this.orderRows));
      this.order = this.integerTexture(gl.R32UI, this.orderRows);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.order);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    this.drawn = count;
  }

  /** Draw a scene on the canvas, which takes the view's size. weight: of what is new in the current group. */
  draw(scene: Scene, weight: number, view: View): void {
    const { canvas } = this;
    if (canvas.width !== view.width || canvas.height !== view.height) [canvas.width, canvas.height] = [view.width, view.height];
    this.drawEyes(scene, weight, [{ framebuffer: null, x: 0, y: 0, view }]);
  }

  /** Draw a scene for each of several views, all in one framebuffer. */
  drawEyes(scene: Scene, weight: number, eyes: Eye[]): void {
    const { gl } = this;
    this.last = { scene, weight, view: eyes[eyes.length - 1].view };
    this.updateFlags(scene);
    gl.bindFramebuffer(gl.FRAMEBUFFER, eyes[0].framebuffer);
    const light = this.lightOf(scene);
    const [red, green, blue] = this.background.map((value, channel) => value * light[channel]);
    gl.clearColor(red, green, blue, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const fades = scene.previous !== null && weight > 0 && weight < 1;
    for (const eye of eyes) {
      this.projectPoints(scene, fades ? 0 : weight, eye.view);
      this.drawSplats(eye);
      if (!fades) continue;
      this.fade.begin(eye.view.width, eye.view.height);
      this.projectPoints(scene, 1, eye.view);
      this.drawSplats({ framebuffer: this.fade.framebuffer, x: 0, y: 0, view: eye.view });
      this.fade.lay(eye, weight);
    }
  }

  private drawSplats({ framebuffer, x, y, view }: Eye): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, view.width, view.height);
    this.splat.use();
    this.splat.texture("uShape", 0, gl.TEXTURE_2D, this.shape);
    this.splat.texture("uColor", 1, gl.TEXTURE_2D, this.color);
    this.splat.texture("uOrder", 2, gl.TEXTURE_2D, this.order);
    gl.uniform2f(this.splat.at("uSize"), view.width, view.height);
    gl.bindVertexArray(this.quads);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    // A row of the order an instance: instances of a single quad are slow on many devices.
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * TEXTURE_WIDTH, gl.UNSIGNED_SHORT, 0, rowsOf(this.drawn));
    gl.disable(gl.BLEND);
  }

  /** RGBA bytes of what was just drawn, top row first. */
  readPixels(): Uint8Array {
    const { gl, canvas } = this;
    const { width, height } = canvas;
    const bottomUp = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bottomUp);
    const result = new Uint8Array(bottomUp.length);
    for (let y = 0; y < height; y++) result.set(bottomUp.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y));
    return result;
  }

  /** Depth at a pixel of the last picture: of the splat at which half of the light is absorbed. */
  depthAt(x: number, y: number): number | null {
    const { gl, last } = this;
    if (!last || !this.holds(last.scene)) return null;
    const { layers, current, previous } = last.scene;
    this.projectPoints(last.scene, last.weight, last.view); // the textures may have grown since
    const groups = [current, previous].map((shown) => shown && this.groups.get(shown.group)?.textures);
    const hits: Hit[] = [];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    for (const file of [...this.layers.slice(0, layers), ...groups]) {
      if (!file || file.count === 0) continue;
      const [shape, color] = [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1].map((attachment) => {
        const words = new Uint32Array(4 * rowsOf(file.count) * TEXTURE_WIDTH);
        gl.readBuffer(attachment);
        gl.readPixels(0, file.firstRow, TEXTURE_WIDTH, rowsOf(file.count), gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
        return words;
      });
      for (const hit of hitsAt(shape, color, x, y)) hits.push(hit);
    }
    return middleDepth(hits);
  }

  /** Free what the GPU holds; the context stays with the canvas. */
  destroy(): void {
    const { gl } = this;
    for (const file of [...this.layers, ...[...this.groups.values()].map((group) => group.textures)]) file?.delete();
    for (const texture of [this.shape, this.color, this.order]) gl.deleteTexture(texture);
    for (const array of [this.quads, this.empty]) gl.deleteVertexArray(array);
    gl.deleteFramebuffer(this.target);
    gl.deleteBuffer(this.corners);
    this.project.delete();
    this.splat.delete();
    this.fade.delete();
  }

  private upload(file: DecodedFile): PointTextures {
    const firstRow = this.rows.take(rowsOf(file.points.count));
    if (this.rows.end > this.capacity) this.grow();
    return new PointTextures(this.gl, firstRow, file.points, file.offsets);
  }

  /** Make room for more splats. Every picture writes them anew, so nothing is copied. */
  private grow(): void {
    const { gl } = this;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE) as number;
    const { end } = this.rows;
    if (end > most) throw new ReelError(`The reel has more points than this device draws (${end * TEXTURE_WIDTH} of ${most * TEXTURE_WIDTH}).`, { plain: PLAIN.device });
    this.capacity = Math.min(Math.max(end, Math.ceil(1.5 * this.capacity)), most);
    for (const texture of [this.shape, this.color]) gl.deleteTexture(texture);
    this.shape = this.integerTexture(gl.RGBA32UI, this.capacity);
    this.color = this.integerTexture(gl.RGBA32UI, this.capacity);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shape, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, this.color, 0);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
  }

  private updateFlags(scene: Scene): void {
    const key = `${scene.layers} ${scene.current?.group} ${scene.previous?.group}`;
    if (key === this.flagsKey) return;
    this.flagsKey = key;
    const layers = this.layers.slice(0, scene.layers);
    const total = layers.reduce((sum, layer) => sum + layer.count, 0);
    const now = scene.current ? this.groups.get(scene.current.group)!.alive : new Uint8Array(total).fill(1);
    const flags = staticFlags(total, now, scene.previous ? this.groups.get(scene.previous.group)!.alive : null);
    let first = 0;
    for (const layer of layers) {
      layer.setFlags(flags.subarray(first, first + layer.count));
      first += layer.count;
    }
  }

  private lightOf({ current }: Scene): Vec3 {
    return current ? lightAt(this.groups.get(current.group)!.light, current.frame) : [1, 1, 1];
  }

  private projectPoints(scene: Scene, weight: number, view: View): void {
    const { gl, project } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.bindVertexArray(this.empty);
    project.use();
    setView(gl, project, view);
    gl.uniform1i(project.at("uAntialias"), this.antialias ? 1 : 0);
    gl.uniform3fv(project.at("uLight"), this.lightOf(scene));
    gl.uniform1i(project.at("uMoving"), 0);
    gl.uniform4fv(project.at("uWeights"), staticWeights(weight));
    for (const layer of this.layers.slice(0, scene.layers)) this.projectFile(layer);
    gl.uniform1i(project.at("uMoving"), 1);
    this.projectGroup(scene.current, weight);
    this.projectGroup(scene.previous, 1 - weight);
  }

  private projectGroup(shown: Shown | null, weight: number): void {
    const group = shown && this.groups.get(shown.group)!.textures;
    if (!shown || !group || !group.range) return;
    const { gl, project } = this;
    const { frames, dxMin, dxStep, dqMin, dqStep, worldly, shade } = group.range;
    const low = Math.min(Math.floor(shown.frame), frames - 1);
    gl.uniform2i(project.at("uFrames"), low, Math.min(low + 1, frames - 1));
    gl.uniform1f(project.at("uBetween"), shown.frame - low);
    gl.uniform3fv(project.at("uDxMin"), dxMin);
    gl.uniform3fv(project.at("uDxStep"), dxStep);
    gl.uniform4fv(project.at("uDqMin"), dqMin);
    gl.uniform4fv(project.at("uDqStep"), dqStep);
    gl.uniform1i(project.at("uWorldly"), worldly ? 1 : 0);
    gl.uniform4fv(project.at("uShadeMin"), shade?.min ?? [0, 0, 0, 0]);
    gl.uniform4fv(project.at("uShadeStep"), shade?.step ?? [0, 0, 0, 0]);
    gl.uniform4f(project.at("uWeights"), weight, 0, 0, 0);
    this.projectFile(group);
  }

  /** One fragment a point of the file, into its rows of the target. */
  private projectFile(file: PointTextures): void {
    if (file.count === 0) return;
    const { gl, project } = this;
    project.texture("uPoints", 0, gl.TEXTURE_2D_ARRAY, file.points);
    project.texture("uCodebook", 1, gl.TEXTURE_2D, file.codebook);
    project.texture("uFlags", 2, gl.TEXTURE_2D, file.flags);
    project.texture("uDx", 3, gl.TEXTURE_2D_ARRAY, file.dx);
    project.texture("uDq", 4, gl.TEXTURE_2D_ARRAY, file.dq);
    project.texture("uShade", 5, gl.TEXTURE_2D_ARRAY, file.shade);
    gl.uniform1i(project.at("uShaded"), file.shade ? 1 : 0);
    gl.uniform1i(project.at("uFirstRow"), file.firstRow);
    gl.uniform1i(project.at("uCount"), file.count);
    gl.uniform1i(project.at("uShDegree"), file.shDegree);
    gl.viewport(0, file.firstRow, TEXTURE_WIDTH, rowsOf(file.count));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private integerTexture(format: number, rows: number): WebGLTexture {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, TEXTURE_WIDTH, rows);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }
}

function isSoftware(gl: WebGL2RenderingContext): boolean {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|softpipe|basic render/i.test(String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER)));
}

/** Camera uniforms; the range is where the Jacobian is evaluated, 1.3 times the field of view as in 3DGS. */
function setView(gl: WebGL2RenderingContext, program: Program, view: View): void {
  const { viewmat: m, fx, fy, cx, cy, width, height } = view;
  const marginX = (0.15 * width) / fx;
  const marginY = (0.15 * height) / fy;
  gl.uniformMatrix4fv(program.at("uView"), true, m);
  gl.uniform3fv(program.at("uEye"), eyeOf(m));
  gl.uniform4f(program.at("uLens"), fx, fy, cx, cy);
  gl.uniform4f(program.at("uRange"), -cx / fx - marginX, (width - cx) / fx + marginX, -cy / fy - marginY, (height - cy) / fy + marginY);
  gl.uniform2f(program.at("uSize"), width, height);
  gl.uniform1f(program.at("uNear"), view.near);
}

/** Indices of two triangles a splat, for as many splats as a row of the order holds. */
function rowOfQuads(): Uint16Array {
  const indices = new Uint16Array(6 * TEXTURE_WIDTH);
  for (let i = 0; i < TEXTURE_WIDTH; i++) indices.set([0, 1, 2, 2, 1, 3].map((corner) => 4 * i + corner), 6 * i);
  return indices;
}
