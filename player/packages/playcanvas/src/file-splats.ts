/** The splats of one file as an entity of a PlayCanvas scene. */
import type { DecodedFile, Offsets } from "@splatreel/decoder/internal";
import { Entity, GSplatContainer, WORKBUFFER_UPDATE_ALWAYS, WORKBUFFER_UPDATE_AUTO, type Texture } from "playcanvas";
import type { UploadedPoints } from "@splatreel/renderer";
import type { Engine } from "./engine";
import { FileTextures, type Side } from "./file-textures";

/** Value of a shader parameter. */
export type Parameter = number | number[] | Texture;

/** Range of the positions of a group in the present frame. */
const low = [0, 0, 0];
const high = [0, 0, 0];

/**
 * A container of splats, which two entities place in the scene. Each has shader parameters of its own, so that PlayCanvas goes from the
 * groups of one scene to those of the next in one step, with the order of the latter.
 */
export class FileSplats implements UploadedPoints<Side> {
  readonly count: number;
  private readonly container: GSplatContainer;
  private readonly sides: [Entity, Entity];
  private readonly textures: FileTextures;
  private readonly means: Float32Array;
  private readonly offsets: Offsets | null;
  private frame = -1;

  constructor(
    private readonly engine: Engine,
    { points, ...file }: DecodedFile,
  ) {
    this.count = points.count;
    this.means = points.means;
    this.offsets = "offsets" in file && this.count > 0 ? file.offsets : null;
    this.container = new GSplatContainer(engine.device, Math.max(this.count, 1), engine.format);
    this.textures = new FileTextures(engine.device, points, this.offsets);
    const parameters = {
      uShDegree: points.shDegree,
      uMoving: this.offsets ? 1 : 0,
      ...this.textures.parameters,
      ...rangesOf(this.offsets),
    };
    this.sides = [this.place(0, parameters), this.place(1, parameters)];
    this.move(0);
  }

  /** Show or hide a side, from the next order of PlayCanvas on. */
  show(side: Side, on: boolean): void {
    this.sides[side].enabled = on && this.count > 0;
  }

  setFlags(flags: Uint8Array, side: Side): void {
    if (this.count > 0) this.textures.setFlags(side, flags);
  }

  /** Draw a frame, counted from the group's first, with these shader parameters. */
  draw(side: Side, frame: number, parameters: Record<string, Parameter>): void {
    const last = (this.offsets?.frames ?? 1) - 1;
    const first = Math.min(Math.floor(frame), last);
    setParameters(this.sides[side], {
      ...parameters,
      uFrames: [first, Math.min(first + 1, last)],
      uBetween: frame - first,
    });
  }

  /** Let PlayCanvas read the splats in every frame, or only after changes that it knows of. */
  keepUpdating(on: boolean): void {
    for (const { gsplat } of this.sides)
      gsplat!.workBufferUpdate = on ? WORKBUFFER_UPDATE_ALWAYS : WORKBUFFER_UPDATE_AUTO;
  }

  /** Set the positions that PlayCanvas sorts to those of a frame. */
  move(frame: number): void {
    if (frame === this.frame || (this.frame >= 0 && !this.offsets)) return;
    this.frame = frame;
    const {
      means,
      container: { centers, aabb },
      offsets,
      count,
    } = this;
    for (let axis = 0; axis < 3; axis++) {
      const { dx, dxMin, dxStep, frames } = offsets ?? { dx: null, dxMin: [0, 0, 0], dxStep: [0, 0, 0], frames: 1 };
      const first = Math.min(Math.floor(frame), frames - 1);
      const [a, b] = [4 * count * first + axis, 4 * count * Math.min(first + 1, frames - 1) + axis];
      let [least, most] = count > 0 ? [Infinity, -Infinity] : [0, 0];
      for (let i = 0, at = axis; i < count; i++, at += 3) {
        const step = dx ? dx[a + 4 * i] + (dx[b + 4 * i] - dx[a + 4 * i]) * (frame - first) : 0;
        const value = (centers[at] = means[at] + dxMin[axis] + dxStep[axis] * step);
        if (value < least) least = value;
        if (value > most) most = value;
      }
      [low[axis], high[axis]] = [least, most];
    }
    const { center, halfExtents } = aabb;
    center.set((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2);
    // Rounding must not leave a point outside, which PlayCanvas would sort wrongly.
    const margin = 1e-3 * Math.max(...high.map((value, axis) => value - low[axis]), 1e-3);
    halfExtents.set((high[0] - low[0]) / 2 + margin, (high[1] - low[1]) / 2 + margin, (high[2] - low[2]) / 2 + margin);
    this.container.update();
  }

  /** Free the memory once PlayCanvas no longer draws the file. */
  delete(): void {
    for (const entity of this.sides) entity.destroy();
    this.container.destroy();
    this.engine.whenUnused(this.container, () => this.textures.delete());
  }

  private place(side: Side, parameters: Record<string, Parameter>): Entity {
    const entity = new Entity("reel file");
    entity.enabled = false;
    entity.addComponent("gsplat", { resource: this.container });
    this.engine.parent.addChild(entity);
    setParameters(entity, { ...parameters, uFlags: this.textures.flags[side] });
    return entity;
  }
}

function setParameters({ gsplat }: Entity, parameters: Record<string, Parameter>): void {
  for (const [name, value] of Object.entries(parameters)) gsplat!.setParameter(name, value);
}

const ZERO = [0, 0, 0, 0];

/** Return the shader parameters of offsets. Each file sets all, since PlayCanvas keeps those of the file drawn before. */
function rangesOf(offsets: Offsets | null): Record<string, Parameter> {
  const appearance = offsets?.appearance;
  return {
    uDxMin: offsets?.dxMin ?? ZERO.slice(1),
    uDxStep: offsets?.dxStep ?? ZERO.slice(1),
    uDqMin: offsets?.dqMin ?? ZERO,
    uDqStep: offsets?.dqStep ?? ZERO,
    uWorldly: offsets?.worldly ? 1 : 0,
    uHasAppearance: appearance ? 1 : 0,
    uAppearanceMin: appearance?.min ?? ZERO,
    uAppearanceStep: appearance?.step ?? ZERO,
  };
}
