/** Textures of one file in a PlayCanvas scene, laid out as in the player. */
import type { Gaussians, Offsets } from "@splatreel/decoder/internal";
import {
  ADDRESS_CLAMP_TO_EDGE,
  FILTER_NEAREST,
  PIXELFORMAT_R8U,
  PIXELFORMAT_RGBA16F,
  PIXELFORMAT_RGBA16U,
  PIXELFORMAT_RGBA32U,
  PIXELFORMAT_RGBA8U,
  Texture,
  type GraphicsDevice,
} from "playcanvas";
import {
  ENTRIES_PER_ROW,
  ENTRY_TEXELS,
  half,
  packCodebook,
  packFlags,
  packPoints,
  POINT_TEXELS,
  rowsOf,
  TEXTURE_WIDTH,
} from "@splatreel/renderer";

/** One of two placements of a file: PlayCanvas draws one until the order of the other is here. */
export type Side = 0 | 1;

type Words = Uint8Array | Uint16Array | Uint32Array;

/** Textures by the names of their shader parameters. Shaders need one for each name, so what a file lacks has a texture of one texel. */
export class FileTextures {
  readonly parameters: Record<string, Texture>;
  /** Textures of the parameter uFlags, one for each side of `FileSplats`. */
  readonly flags: [Texture, Texture];

  constructor(
    private readonly device: GraphicsDevice,
    points: Gaussians,
    offsets: Offsets | null,
  ) {
    const rows = Math.max(rowsOf(points.count), 1);
    const words = points.count > 0 ? packPoints(points) : new Uint32Array(POINT_TEXELS * 4 * TEXTURE_WIDTH);
    const layer = 4 * rows * TEXTURE_WIDTH;
    const { dx, dq, appearance, frames } = offsets ?? { dx: null, dq: null, appearance: null, frames: 1 };
    const codebook =
      points.shDegree > 0
        ? packCodebook(points)
        : { values: new Float32Array(4 * ENTRIES_PER_ROW * ENTRY_TEXELS), rows: 1 };
    this.parameters = {
      uPoints: this.array(
        "uPoints",
        PIXELFORMAT_RGBA32U,
        TEXTURE_WIDTH,
        rows,
        [0, 1, 2].map((i) => words.subarray(i * layer, (i + 1) * layer)),
      ),
      uCodebook: this.create(
        "uCodebook",
        PIXELFORMAT_RGBA16F,
        ENTRIES_PER_ROW * ENTRY_TEXELS,
        codebook.rows,
        Uint16Array.from(codebook.values, half),
      ),
      uDx: this.frames("uDx", PIXELFORMAT_RGBA16U, dx, frames, Uint16Array),
      uDq: this.frames("uDq", PIXELFORMAT_RGBA8U, dq, frames, Uint8Array),
      uAppearance: this.frames("uAppearance", PIXELFORMAT_RGBA8U, appearance?.data ?? null, frames, Uint8Array),
    };
    const flags = (): Texture =>
      this.create("uFlags", PIXELFORMAT_R8U, TEXTURE_WIDTH, rows, new Uint8Array(rows * TEXTURE_WIDTH));
    this.flags = [flags(), flags()];
  }

  /** Set the flags [N] of `staticFlags` of one side. */
  setFlags(side: Side, flags: Uint8Array): void {
    const texture = this.flags[side];
    (texture.lock() as Uint8Array).set(packFlags(flags));
    texture.unlock();
  }

  delete(): void {
    for (const texture of [...Object.values(this.parameters), ...this.flags]) texture.destroy();
  }

  /** Create a texture of [T, N, 4] values with one layer per frame. */
  private frames(
    name: string,
    format: number,
    values: Words | null,
    frames: number,
    kind: new (length: number) => Words,
  ): Texture {
    if (!values) return this.array(name, format, 1, 1, [new kind(4)]);
    const length = values.length / frames;
    const rows = rowsOf(length / 4);
    const layers = Array.from({ length: frames }, (_, t) => {
      const layer = new kind(4 * rows * TEXTURE_WIDTH);
      layer.set(values.subarray(t * length, (t + 1) * length));
      return layer;
    });
    return this.array(name, format, TEXTURE_WIDTH, rows, layers);
  }

  private array(name: string, format: number, width: number, height: number, layers: Words[]): Texture {
    return this.create(name, format, width, height, layers as Uint8Array[], layers.length);
  }

  private create(
    name: string,
    format: number,
    width: number,
    height: number,
    level: Words | Uint8Array[],
    arrayLength = 0,
  ): Texture {
    const nearest = {
      mipmaps: false,
      minFilter: FILTER_NEAREST,
      magFilter: FILTER_NEAREST,
      addressU: ADDRESS_CLAMP_TO_EDGE,
      addressV: ADDRESS_CLAMP_TO_EDGE,
    };
    return new Texture(this.device, {
      name,
      width,
      height,
      format,
      arrayLength,
      levels: [level] as Uint8Array[][],
      ...nearest,
    });
  }
}
