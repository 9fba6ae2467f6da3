/** Draws Gaussians into the scene of a three.js renderer, with its depth buffer. */
import type { DecodedGroup, DecodedLayer } from "@splatreel/decoder/decode/decode-file";
import type { View } from "splatreel-player/base/view";
import type { Eye } from "splatreel-player/draw/eye";
import type { Scene } from "splatreel-player/draw/scene";
import { WebglRenderer } from "splatreel-player/webgl/webgl-renderer";
import { SRGBColorSpace, type WebGLRenderer } from "three";
import { isReversed, withRawGl } from "./raw-gl";
import { depthFragment, depthVertex } from "./shaders";

/** Least alpha of a splat that writes depth. */
const SOLID = 0.5;

/** How splats are drawn. */
export interface Look {
  /** Write the depth of splats, so that meshes drawn later are hidden behind them. */
  depthWrite: boolean;
  /** Factor on all opacities, 0 to 1. */
  opacity: number;
}

/** Renderer of one reel. */
export class ThreeRenderer extends WebglRenderer {
  /** Depth in clip space: -depth[0] + depth[1] / distance. */
  depth: [number, number] = [0, 0];

  constructor(private readonly three: WebGLRenderer, private readonly look: Look) {
    super(three.domElement, [depthVertex, depthFragment]);
  }

  /** Create one with three's state restored. Throws `ReelError`. */
  static create(three: WebGLRenderer, look: Look): ThreeRenderer {
    return withRawGl(three, () => new ThreeRenderer(three, look));
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
    withRawGl(this.three, () => super.destroy());
  }

  /** Draw where three.js draws now. In a cross-fade, points fade instead of images, since meshes may be between them. */
  override drawEyes(scene: Scene, weight: number, [eye]: Eye[]): void {
    withRawGl(this.three, (target) => {
      const { gl, memory, projection, splats, look } = this;
      this.last = { scene, weight, view: eye.view };
      memory.flagStatics(scene);
      projection.run(scene, weight, eye.view, this.antialias);
      const { x, y } = target.viewport;
      const place = { framebuffer: target.framebuffer, x, y, view: eye.view };
      if (target.scissor) {
        gl.enable(gl.SCISSOR_TEST);
        gl.scissor(target.scissor[0], target.scissor[1], target.scissor[2], target.scissor[3]);
      }
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(isReversed(this.three) ? gl.GEQUAL : gl.LEQUAL);
      gl.depthMask(false);
      splats.run(place, (program) => this.prepare(program, 0));
      if (!look.depthWrite) return;
      gl.depthMask(true);
      gl.colorMask(false, false, false, false);
      splats.run(place, (program) => this.prepare(program, SOLID));
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

  private prepare(program: { at(name: string): WebGLUniformLocation | null }, cutoff: number): void {
    const { gl, three, depth } = this;
    const target = three.getRenderTarget();
    const space = target ? target.texture.colorSpace : three.outputColorSpace;
    gl.uniform2f(program.at("uDepth"), depth[0], depth[1]);
    gl.uniform1f(program.at("uCutoff"), cutoff);
    gl.uniform1f(program.at("uOpacity"), this.look.opacity);
    gl.uniform1i(program.at("uLinear"), space === SRGBColorSpace ? 0 : 1);
  }
}
