/** Draws Gaussians in WebGL 2, in two passes: project each point into a splat, then draw the sorted splats. */
import { type DecodedGroup, type DecodedLayer, PLAIN, ReelError, type Vec3 } from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { Cutaway } from "../draw/cutaway";
import type { Eye } from "../draw/eye";
import type { HeadsetLayer, Renderer } from "../draw/renderer";
import type { Scene } from "../draw/scene";
import { TEXTURE_WIDTH } from "../draw/texture-layout";
import { CrossFade } from "./cross-fade";
import { GpuMemory } from "./gpu-memory";
import { ProjectionPass } from "./projection-pass";
import { SplatPass, type SplatShaders } from "./splat-pass";
import { rowsOf } from "../draw/point-words";

/** A splat at a pixel. */
interface Hit {
  depth: number;
  alpha: number;
}

/** Return the splats that cover a pixel. shape, color: [N, 4] words of the splat target. */
export function hitsAt(shape: Uint32Array, color: Uint32Array, x: number, y: number): Hit[] {
  const shapes = new Float32Array(shape.buffer);
  const colors = new Float32Array(color.buffer);
  const hits: Hit[] = [];
  for (let at = 0; at < shape.length; at += 4) {
    const extent = colors[at + 2];
    if (!(extent > 0)) continue;
    const dx = x - shapes[at];
    const dy = y - shapes[at + 1];
    // The axes end with the splat, at `extent` standard deviations.
    const u = along(shape[at + 2], dx, dy);
    const v = along(shape[at + 3], dx, dy);
    const square = (u * u + v * v) * extent * extent;
    if (square < extent * extent)
      hits.push({ depth: colors[at + 3], alpha: float(color[at + 1] >>> 16) * Math.exp(-0.5 * square) });
  }
  return hits;
}

/** Return the depth of the hit at which a share of the light is absorbed, 0 to 1; null if less is. */
export function depthOf(hits: Hit[], share: number): number | null {
  let light = 1;
  for (const { depth, alpha } of hits.sort((a, b) => a.depth - b.depth)) {
    light *= 1 - alpha;
    if (light < 1 - share) return depth;
  }
  return null;
}

/** Project a vector onto an axis of two packed half-precision numbers, in units of its length. */
function along(packed: number, dx: number, dy: number): number {
  const [x, y] = [float(packed & 0xffff), float(packed >>> 16)];
  return (x * dx + y * dy) / Math.max(x * x + y * y, 1e-12);
}

/** Return the value of a half-precision number. */
export function float(bits: number): number {
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  const size = exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25);
  return bits & 0x8000 ? -size : size;
}

/** Part of WebXR that TypeScript does not describe. */
declare const XRWebGLLayer: new (session: object, gl: WebGL2RenderingContext) => HeadsetLayer;

/** Renderer for a WebGL 2 context. */
export class WebglRenderer implements Renderer {
  readonly software: boolean;
  protected readonly gl: WebGL2RenderingContext;
  protected readonly memory: GpuMemory;
  protected readonly projection: ProjectionPass;
  protected readonly splats: SplatPass;
  private readonly fade: CrossFade;
  protected last: { scene: Scene; weight: number; view: View } | null = null;
  transparent = false;
  passthrough = false;
  cutaway: Cutaway | null = null;
  protected antialias = false;
  private background: Vec3 = [0, 0, 0];

  /** Throws `ReelError` if the browser has no WebGL 2. shaders: of the second pass. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    shaders?: SplatShaders,
  ) {
    const gl = canvas.getContext("webgl2", {
      alpha: true,
      antialias: false,
      depth: false,
      powerPreference: "high-performance",
    });
    if (!gl)
      throw new ReelError("This browser or device lacks WebGL 2, which the player needs to draw.", {
        plain: PLAIN.device,
      });
    this.gl = gl;
    this.software = isSoftware(gl);
    this.memory = new GpuMemory(gl);
    this.projection = new ProjectionPass(gl, this.memory);
    this.splats = new SplatPass(gl, this.memory.target, shaders);
    this.fade = new CrossFade(gl);
  }

  /** Wait until the driver has compiled the shaders. Throws `ReelError` if it rejects one. */
  begin(antialias: boolean, background: Vec3): void {
    [this.antialias, this.background] = [antialias, background];
    this.projection.check();
    this.splats.check();
    this.fade.check();
  }

  get lost(): boolean {
    return this.gl.isContextLost();
  }

  get points(): number {
    return this.splats.count;
  }

  addLayer(uri: string, file: DecodedLayer): number {
    return this.memory.addLayer(uri, file).firstRow * TEXTURE_WIDTH;
  }

  addGroup(index: number, file: DecodedGroup, layers: string[]): number {
    return this.memory.addGroup(index, file, layers).firstRow * TEXTURE_WIDTH;
  }

  dropLayer(uri: string): void {
    this.memory.dropLayer(uri);
  }

  dropGroup(index: number): void {
    this.memory.dropGroup(index);
  }

  holds(scene: Scene): boolean {
    return this.memory.holds(scene);
  }

  setOrder(order: Uint32Array, count: number): void {
    this.splats.setOrder(order, count);
  }

  draw(scene: Scene, weight: number, view: View): void {
    const { canvas } = this;
    if (canvas.width !== view.width || canvas.height !== view.height)
      [canvas.width, canvas.height] = [view.width, view.height];
    this.drawEyes(scene, weight, [{ framebuffer: null, x: 0, y: 0, view }]);
  }

  /** Draw all eyes into one framebuffer. In a cross-fade each group is drawn as an image of its own. */
  drawEyes(scene: Scene, weight: number, eyes: Eye[]): void {
    const { memory, projection, splats, fade, antialias } = this;
    splats.transparent = fade.transparent = this.isClear(eyes[0].framebuffer);
    this.last = { scene, weight, view: eyes[eyes.length - 1].view };
    memory.flagStatics(scene);
    this.clear(eyes[0].framebuffer, memory.lightOf(scene));
    const fades = scene.previous !== null && weight > 0 && weight < 1;
    for (const eye of eyes) {
      projection.run(scene, fades ? 0 : weight, eye.view, antialias, this.cutaway);
      splats.run(eye);
      if (!fades) continue;
      fade.begin(eye.view.width, eye.view.height);
      projection.run(scene, 1, eye.view, antialias, this.cutaway);
      splats.run({ framebuffer: fade.framebuffer, x: 0, y: 0, view: eye.view });
      fade.blend(eye, weight);
    }
  }

  readPixels(): Uint8Array {
    const { gl, canvas } = this;
    const { width, height } = canvas;
    const bottomUp = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bottomUp);
    if (this.transparent) unmultiply(bottomUp);
    const result = new Uint8Array(bottomUp.length);
    for (let y = 0; y < height; y++)
      result.set(bottomUp.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y));
    return result;
  }

  /** Return the depth of the splat at which a share of the light is absorbed. */
  depthAt(x: number, y: number, share = 0.5): number | null {
    const { last, memory } = this;
    if (!last || !memory.holds(last.scene)) return null;
    const { current, previous } = last.scene;
    this.projection.run(last.scene, last.weight, last.view, this.antialias, this.cutaway); // the target may have been reallocated
    const groups = [current, previous].map((shown) => shown && memory.group(shown.group));
    const hits: Hit[] = [];
    for (const file of [...memory.layersOf(last.scene), ...groups]) {
      if (!file || file.count === 0) continue;
      const [shape, color] = memory.target.read(file.firstRow, rowsOf(file.count));
      for (const hit of hitsAt(shape, color, x, y)) hits.push(hit);
    }
    return depthOf(hits, share);
  }

  async createHeadsetLayer(session: object): Promise<HeadsetLayer> {
    await (this.gl as WebGL2RenderingContext & { makeXRCompatible(): Promise<void> }).makeXRCompatible();
    return new XRWebGLLayer(session, this.gl);
  }

  destroy(): void {
    this.memory.delete();
    this.projection.delete();
    this.splats.delete();
    this.fade.delete();
  }

  /** Return true if the page, or in a headset the room, shows through a framebuffer. */
  private isClear(framebuffer: WebGLFramebuffer | null): boolean {
    return framebuffer ? this.passthrough : this.transparent;
  }

  /** Clear to the background, scaled by the light of the scene, or to nothing. */
  private clear(framebuffer: WebGLFramebuffer | null, light: Vec3): void {
    const { gl } = this;
    const [red, green, blue] = this.background;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    if (this.isClear(framebuffer)) gl.clearColor(0, 0, 0, 0);
    else gl.clearColor(red * light[0], green * light[1], blue * light[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }
}

/** Divide the colors of RGBA bytes by alpha, in place: canvases hold products, images do not. */
function unmultiply(pixels: Uint8Array): void {
  for (let i = 0; i < pixels.length; i += 4) {
    const alpha = pixels[i + 3];
    if (alpha === 0 || alpha === 255) continue;
    for (let c = 0; c < 3; c++) pixels[i + c] = Math.min(Math.round((255 * pixels[i + c]) / alpha), 255);
  }
}

function isSoftware(gl: WebGL2RenderingContext): boolean {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|softpipe|basic render/i.test(
    String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER)),
  );
}
