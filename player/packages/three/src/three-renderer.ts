/** Draws Gaussians into the scene of a three.js renderer, with its depth buffer. */
import type { DecodedGroup, DecodedLayer } from "@splatreel/decoder/internal";
import { type Eye, type Scene, type View, WebglRenderer } from "@splatreel/renderer";
import { Color, LinearSRGBColorSpace, SRGBColorSpace, type WebGLRenderTarget, type WebGLRenderer } from "three";
import { BlendTarget } from "./blend-target";
import { isReversed, withRawGl } from "./raw-gl";
import { depthFragment, depthVertex } from "./shaders";
import type { CameraView } from "./views";

/** Least alpha of a splat that writes depth. */
const SOLID = 0.5;

/** Fog of a scene: linear between two distances, or exponential with a density. */
export interface SceneFog {
  color: Color;
  near?: number;
  far?: number;
  density?: number;
}

/** How splats are drawn. */
export interface Look {
  /** Write the depth of splats, so that meshes drawn later are hidden behind them. */
  depthWrite: boolean;
  /** Factor on all opacities, 0 to 1. */
  opacity: number;
  /** Fog of the scene; null for none. */
  fog: SceneFog | null;
  /** Scale of the reel in the scene. */
  scale: number;
}

/** Renderer of one reel. */
export class ThreeRenderer extends WebglRenderer {
  /** Depth in clip space, as in `CameraView`. */
  depth: CameraView["depth"] = [0, 0, 0, 0];
  private readonly blend: BlendTarget;
  private readonly fogColor = new Color();

  constructor(
    private readonly three: WebGLRenderer,
    private readonly look: Look,
  ) {
    super(three.domElement, [depthVertex, depthFragment]);
    this.blend = new BlendTarget(this.gl);
  }

  /** Create one with three's state restored. Throws `ReelError`. */
  static create(three: WebGLRenderer, look: Look): ThreeRenderer {
    return withRawGl(three, () => new ThreeRenderer(three, look));
  }

  override begin(antialias: boolean, background: [number, number, number]): void {
    super.begin(antialias, background);
    this.blend.check();
  }

  override addLayer(uri: string, file: DecodedLayer): number {
    return withRawGl(this.three, () => super.addLayer(uri, file));
  }

  override addGroup(index: number, file: DecodedGroup, layers: string[]): number {
    return withRawGl(this.three, () => super.addGroup(index, file, layers));
  }

  override setOrder(order: Uint32Array, count: number): void {
    withRawGl(this.three, () => super.setOrder(order, count));
  }

  override depthAt(x: number, y: number): number | null {
    return withRawGl(this.three, () => super.depthAt(x, y));
  }

  override destroy(): void {
    withRawGl(this.three, () => {
      super.destroy();
      this.blend.delete();
    });
  }

  /** Draw where three.js draws now. In a cross-fade, points fade instead of images, since meshes may be between them. */
  override drawEyes(scene: Scene, weight: number, [eye]: Eye[]): void {
    withRawGl(this.three, (target) => {
      const { gl, memory, projection, blend } = this;
      this.last = { scene, weight, view: eye.view };
      memory.flagStatics(scene);
      projection.run(scene, weight, eye.view, this.antialias);
      const { x, y, z: width, w: height } = target.viewport;
      if (target.scissor) {
        gl.enable(gl.SCISSOR_TEST);
        gl.scissor(target.scissor[0], target.scissor[1], target.scissor[2], target.scissor[3]);
      }
      const region = { x, y, width, height };
      const { renderTarget: whole } = target;
      const linear = isLinear(this.three, whole);
      // Splats are trained to be blended in sRGB. Where the target has linear colors, they are blended elsewhere and converted once.
      if (linear && whole && target.framebuffer && blend.begin(target.framebuffer, whole, region)) {
        this.drawSplats({ framebuffer: blend.framebuffer, x, y, view: eye.view }, false);
        blend.end(region);
      } else this.drawSplats({ framebuffer: target.framebuffer, x, y, view: eye.view }, linear);
    });
  }

  /** Return the depth along a view whose center is the pixel (1, 1); null if nothing is there. */
  depthAlong(view: View): number | null {
    const { last } = this;
    if (!last) return null;
    this.last = { ...last, view };
    try {
      return this.depthAt(1, 1);
    } finally {
      this.last = last;
    }
  }

  /** linear: convert each splat to linear colors. */
  private drawSplats(place: Eye, linear: boolean): void {
    const { gl, splats } = this;
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(isReversed(this.three) ? gl.GEQUAL : gl.LEQUAL);
    gl.depthMask(false);
    splats.run(place, (program) => this.prepare(program, 0, linear));
    if (!this.look.depthWrite) return;
    gl.depthMask(true);
    gl.colorMask(false, false, false, false);
    splats.run(place, (program) => this.prepare(program, SOLID, linear));
  }

  private prepare(program: { at(name: string): WebGLUniformLocation | null }, cutoff: number, linear: boolean): void {
    const {
      gl,
      depth,
      look: { fog, opacity, scale },
      fogColor,
    } = this;
    gl.uniform4fv(program.at("uDepth"), depth);
    gl.uniform1f(program.at("uCutoff"), cutoff);
    gl.uniform1f(program.at("uOpacity"), opacity);
    gl.uniform1i(program.at("uLinear"), linear ? 1 : 0);
    fog?.color.getRGB(fogColor, SRGBColorSpace);
    gl.uniform4f(program.at("uFogColor"), fogColor.r, fogColor.g, fogColor.b, fog ? 1 : 0);
    gl.uniform4f(program.at("uFog"), fog?.near ?? 0, fog?.far ?? 1, fog?.density ?? 0, scale);
  }
}

/** Return true if three.js draws linear colors now: into render targets, except those of headsets. */
function isLinear(three: WebGLRenderer, target: (WebGLRenderTarget & { isXRRenderTarget?: boolean }) | null): boolean {
  const space = !target
    ? three.outputColorSpace
    : target.isXRRenderTarget
      ? target.texture.colorSpace
      : LinearSRGBColorSpace;
  return space !== SRGBColorSpace;
}
