/** A target in which splats are blended in sRGB, before they are converted once into a render target with linear colors. */
import { coverVertex, Program } from "@splatreel/renderer";
import { convertFragment } from "./shaders";

/** Part of a framebuffer, in pixels from its lower left corner. */
export interface Region {
  x: number;
  y: number;
  width: number;
  height: number;
}

type DepthBuffer = WebGLRenderbuffer | WebGLTexture;

/** What decides the format of the target. */
interface Key {
  framebuffer: WebGLFramebuffer;
  depth: DepthBuffer | null;
  width: number;
  height: number;
}

/** Colors of splats in sRGB, with the depth buffer of the render target that they will be in, and what is behind them. */
export class BlendTarget {
  /** Framebuffer to draw splats into, at their place in the render target. */
  readonly framebuffer: WebGLFramebuffer;
  private readonly program: Program;
  private readonly empty: WebGLVertexArrayObject;
  /** Framebuffers of the two textures. */
  private readonly behindCopy: WebGLFramebuffer;
  private readonly splatCopy: WebGLFramebuffer;
  private behind: WebGLTexture | null = null;
  private splats: WebGLTexture | null = null;
  /** Colors with several samples per pixel; null with one. */
  private samples: WebGLRenderbuffer | null = null;
  private key: Key | null = null;
  private usable = false;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.program = new Program(gl, coverVertex, convertFragment);
    this.empty = gl.createVertexArray();
    [this.framebuffer, this.behindCopy, this.splatCopy] = [
      gl.createFramebuffer(),
      gl.createFramebuffer(),
      gl.createFramebuffer(),
    ];
  }

  /** Wait for the shaders. Throws `ReelError` if the driver rejects them. */
  check(): void {
    this.program.check();
  }

  /** Copy what is behind the splats, and clear the target. width, height: of the whole render target. Returns false if the render target cannot lend its depth buffer. */
  begin(
    framebuffer: WebGLFramebuffer,
    { width, height }: { width: number; height: number },
    { x, y, ...size }: Region,
  ): boolean {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    const depth = attached(gl, gl.DEPTH_ATTACHMENT, gl.FRAMEBUFFER_ATTACHMENT_OBJECT_NAME) as DepthBuffer | null;
    const { key } = this;
    if (key?.framebuffer !== framebuffer || key.depth !== depth || key.width !== width || key.height !== height) {
      this.key = { framebuffer, depth, width, height };
      this.usable = this.allocate(this.key);
    }
    if (!this.usable) return false;
    copy(gl, framebuffer, this.behindCopy, x, y, x + size.width, y + size.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    return true;
  }

  /** Put the splats over what is behind them in the render target of `begin`. */
  end({ x, y, width, height }: Region): void {
    const { gl, program } = this;
    if (this.samples) copy(gl, this.framebuffer, this.splatCopy, x, y, x + width, y + height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.key!.framebuffer);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0]); // three.js sets its own again
    gl.viewport(x, y, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.depthMask(false);
    gl.colorMask(true, true, true, true);
    program.use();
    program.texture("uSplats", 0, gl.TEXTURE_2D, this.splats);
    program.texture("uBehind", 1, gl.TEXTURE_2D, this.behind);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  delete(): void {
    const { gl } = this;
    this.free();
    for (const framebuffer of [this.framebuffer, this.behindCopy, this.splatCopy]) gl.deleteFramebuffer(framebuffer);
    gl.deleteVertexArray(this.empty);
    this.program.delete();
  }

  private free(): void {
    const { gl } = this;
    for (const texture of [this.behind, this.splats]) gl.deleteTexture(texture);
    gl.deleteRenderbuffer(this.samples);
    [this.behind, this.splats, this.samples] = [null, null, null];
  }

  /** Create textures for the render target that is bound. Returns false if the framebuffers would be incomplete. */
  private allocate({ width, height }: Key): boolean {
    const { gl } = this;
    this.free();
    const samples = gl.getParameter(gl.SAMPLES) as number;
    // Samples are resolved only into their own format; other colors are converted.
    const format = samples > 0 ? formatOfColor(gl) : gl.getExtension("EXT_color_buffer_float") ? gl.RGBA16F : gl.RGBA8;
    if (format === null) return false;
    const point =
      attached(gl, gl.STENCIL_ATTACHMENT, gl.FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) === gl.NONE
        ? gl.DEPTH_ATTACHMENT
        : gl.DEPTH_STENCIL_ATTACHMENT;
    const attachDepth = depthAttacher(gl, point);
    this.behind = textureOf(gl, format, width, height);
    this.splats = textureOf(gl, gl.RGBA8, width, height);
    const attachTexture = (framebuffer: WebGLFramebuffer, texture: WebGLTexture): boolean => {
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      return isComplete(gl);
    };
    if (!attachTexture(this.behindCopy, this.behind) || !attachTexture(this.splatCopy, this.splats)) return false;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    for (const old of [gl.DEPTH_ATTACHMENT, gl.DEPTH_STENCIL_ATTACHMENT])
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, old, gl.RENDERBUFFER, null);
    if (samples > 0) {
      this.samples = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.samples);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, gl.RGBA8, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, this.samples);
    } else gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.splats, 0);
    attachDepth();
    return isComplete(gl);
  }
}

/** Return a parameter of an attachment of the bound framebuffer. */
function attached(gl: WebGL2RenderingContext, attachment: number, parameter: number): unknown {
  const type = gl.getFramebufferAttachmentParameter(
    gl.FRAMEBUFFER,
    attachment,
    gl.FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE,
  ) as number;
  if (parameter === gl.FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) return type;
  return type === gl.NONE ? null : gl.getFramebufferAttachmentParameter(gl.FRAMEBUFFER, attachment, parameter);
}

/** Return a function that attaches the depth buffer of the framebuffer bound now to the one bound then. */
function depthAttacher(gl: WebGL2RenderingContext, point: number): () => void {
  const ask = (parameter: number): number => attached(gl, gl.DEPTH_ATTACHMENT, parameter) as number;
  const type = ask(gl.FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE);
  const depth = attached(gl, gl.DEPTH_ATTACHMENT, gl.FRAMEBUFFER_ATTACHMENT_OBJECT_NAME) as DepthBuffer | null;
  if (type === gl.RENDERBUFFER) return () => gl.framebufferRenderbuffer(gl.FRAMEBUFFER, point, gl.RENDERBUFFER, depth);
  if (type !== gl.TEXTURE) return () => undefined;
  const [face, level] = [
    ask(gl.FRAMEBUFFER_ATTACHMENT_TEXTURE_CUBE_MAP_FACE),
    ask(gl.FRAMEBUFFER_ATTACHMENT_TEXTURE_LEVEL),
  ];
  return () => gl.framebufferTexture2D(gl.FRAMEBUFFER, point, face || gl.TEXTURE_2D, depth, level);
}

/** Return the format of the color renderbuffer of the bound framebuffer; null if its colors are in a texture. */
function formatOfColor(gl: WebGL2RenderingContext): number | null {
  if (attached(gl, gl.COLOR_ATTACHMENT0, gl.FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) !== gl.RENDERBUFFER) return null;
  gl.bindRenderbuffer(
    gl.RENDERBUFFER,
    attached(gl, gl.COLOR_ATTACHMENT0, gl.FRAMEBUFFER_ATTACHMENT_OBJECT_NAME) as WebGLRenderbuffer,
  );
  return gl.getRenderbufferParameter(gl.RENDERBUFFER, gl.RENDERBUFFER_INTERNAL_FORMAT) as number;
}

function textureOf(gl: WebGL2RenderingContext, format: number, width: number, height: number): WebGLTexture {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return texture;
}

function isComplete(gl: WebGL2RenderingContext): boolean {
  return gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
}

/** Copy colors to the same place of another framebuffer. */
function copy(
  gl: WebGL2RenderingContext,
  from: WebGLFramebuffer,
  to: WebGLFramebuffer,
  left: number,
  bottom: number,
  right: number,
  top: number,
): void {
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to);
  gl.blitFramebuffer(left, bottom, right, top, left, bottom, right, top, gl.COLOR_BUFFER_BIT, gl.NEAREST);
}
