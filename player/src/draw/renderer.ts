/** Draws a reel's points in WebGL2, in two passes. Knows nothing about time or downloads: it is told what to show. */
import { PLAIN, ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import type { View } from "../base/view";
import { CrossFade } from "./cross-fade";
import type { Eye } from "./eye";
import { GpuMemory } from "./gpu-memory";
import { hitsAt, middleDepth, type Hit } from "./pick";
import { ProjectionPass } from "./projection-pass";
import type { Scene } from "./scene";
import { SplatPass } from "./splat-pass";
import { rowsOf } from "./textures";

export class Renderer {
  readonly memory: GpuMemory;
  /** The browser draws without a graphics device. */
  readonly software: boolean;
  private readonly gl: WebGL2RenderingContext;
  private readonly projection: ProjectionPass;
  private readonly splats: SplatPass;
  private readonly fade: CrossFade;
  private last: { scene: Scene; weight: number; view: View } | null = null;
  /** Splats thinner than a pixel are drawn fainter. */
  private antialias = false;
  /** Red, green and blue where nothing is drawn. */
  private background: Vec3 = [0, 0, 0];

  /** Throws `ReelError` where there is no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new ReelError("This browser or device offers no WebGL 2, which the player draws with.", { plain: PLAIN.device });
    this.gl = gl;
    this.software = isSoftware(gl);
    this.memory = new GpuMemory(gl);
    this.projection = new ProjectionPass(gl, this.memory);
    this.splats = new SplatPass(gl, this.memory.target);
    this.fade = new CrossFade(gl);
  }

  /** Once it is known what is drawn: wait for what the driver still does. Throws `ReelError` where it cannot draw the player's pictures. */
  begin(antialias: boolean, background: Vec3): void {
    [this.antialias, this.background] = [antialias, background];
    this.projection.check();
    this.splats.check();
    this.fade.check();
  }

  get lost(): boolean {
    return this.gl.isContextLost();
  }

  /** Points in the order. */
  get points(): number {
    return this.splats.count;
  }

  /** Far-to-near order of points, as the sort worker gave it: whole rows, of which `count` entries are points. */
  setOrder(order: Uint32Array, count: number): void {
    this.splats.setOrder(order, count);
  }

  /** Draw a scene on the canvas, which takes the view's size. weight: of what is new in the current group. */
  draw(scene: Scene, weight: number, view: View): void {
    const { canvas } = this;
    if (canvas.width !== view.width || canvas.height !== view.height) [canvas.width, canvas.height] = [view.width, view.height];
    this.drawEyes(scene, weight, [{ framebuffer: null, x: 0, y: 0, view }]);
  }

  /** Draw a scene for each of several views, all in one framebuffer. Where a group fades into the next, both have a picture. */
  drawEyes(scene: Scene, weight: number, eyes: Eye[]): void {
    const { memory, projection, splats, fade, antialias } = this;
    this.last = { scene, weight, view: eyes[eyes.length - 1].view };
    memory.flagStatics(scene);
    this.clear(eyes[0].framebuffer, memory.lightOf(scene));
    const fades = scene.previous !== null && weight > 0 && weight < 1;
    for (const eye of eyes) {
      projection.run(scene, fades ? 0 : weight, eye.view, antialias);
      splats.run(eye);
      if (!fades) continue;
      fade.begin(eye.view.width, eye.view.height);
      projection.run(scene, 1, eye.view, antialias);
      splats.run({ framebuffer: fade.framebuffer, x: 0, y: 0, view: eye.view });
      fade.lay(eye, weight);
    }
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
    const { last, memory } = this;
    if (!last || !memory.holds(last.scene)) return null;
    const { current, previous } = last.scene;
    this.projection.run(last.scene, last.weight, last.view, this.antialias); // the target may have grown since
    const groups = [current, previous].map((shown) => shown && memory.group(shown.group));
    const hits: Hit[] = [];
    for (const file of [...memory.layersOf(last.scene), ...groups]) {
      if (!file || file.count === 0) continue;
      const [shape, color] = memory.target.read(file.firstRow, rowsOf(file.count));
      for (const hit of hitsAt(shape, color, x, y)) hits.push(hit);
    }
    return middleDepth(hits);
  }

  /** Free what the GPU holds; the context stays with the canvas. */
  destroy(): void {
    this.memory.delete();
    this.projection.delete();
    this.splats.delete();
    this.fade.delete();
  }

  /** The background is lit as the scene is. */
  private clear(framebuffer: WebGLFramebuffer | null, light: Vec3): void {
    const { gl } = this;
    const [red, green, blue] = this.background;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.clearColor(red * light[0], green * light[1], blue * light[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }
}

function isSoftware(gl: WebGL2RenderingContext): boolean {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|softpipe|basic render/i.test(String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER)));
}
