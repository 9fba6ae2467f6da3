/** Direct use of the WebGL context of a three.js renderer, whose cached state is restored afterwards. */
import { Vector4, type WebGLRenderTarget, type WebGLRenderer } from "three";

/** Where three.js draws now. */
export interface DrawTarget {
  /** Render target of three.js; null for the canvas. `getRenderTarget` does not know it while raw WebGL is used. */
  renderTarget: WebGLRenderTarget | null;
  framebuffer: WebGLFramebuffer | null;
  /** x, y, width and height in pixels, from the lower left corner. */
  viewport: Vector4;
  /** The same; null if nothing is cut off. */
  scissor: Int32Array | null;
}

/** State of three.js that `resetState` does not keep. Older versions have no reversed depth. */
interface DepthState {
  getReversed?(): boolean;
  setReversed?(reversed: boolean): void;
  setClear(depth: number): void;
}

/** Return true if near points have larger depths than far ones. */
export function isReversed(renderer: WebGLRenderer): boolean {
  return (renderer.state.buffers.depth as unknown as DepthState).getReversed?.() ?? false;
}

/** Run `work` in WebGL's initial state. */
export function withRawGl<T>(renderer: WebGLRenderer, work: (target: DrawTarget) => T): T {
  const gl = renderer.getContext() as WebGL2RenderingContext;
  const [target, face, level] = [
    renderer.getRenderTarget(),
    renderer.getActiveCubeFace(),
    renderer.getActiveMipmapLevel(),
  ];
  const viewport = renderer.getCurrentViewport(new Vector4());
  const framebuffer = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING) as WebGLFramebuffer | null;
  const scissor = gl.isEnabled(gl.SCISSOR_TEST) ? (gl.getParameter(gl.SCISSOR_BOX) as Int32Array) : null;
  const { depth } = renderer.state.buffers as unknown as { depth: DepthState };
  const reversed = isReversed(renderer);
  const reset = (): void => {
    renderer.resetState();
    depth.setReversed?.(reversed);
    depth.setClear(1);
  };
  reset();
  for (let unit = 0; unit < 6; unit++) gl.bindSampler(unit, null);
  try {
    return work({ renderTarget: target, framebuffer, viewport, scissor });
  } finally {
    reset();
    renderer.setRenderTarget(target, face, level);
    renderer.state.viewport(viewport);
  }
}
