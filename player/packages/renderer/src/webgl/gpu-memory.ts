/** GPU memory of a reel: the points of its layers and groups. Each file owns rows of the splat target. */
import type { DecodedFile } from "@splatreel/decoder/internal";
import { rowsOf } from "../draw/point-words";
import { UploadedFiles } from "../draw/uploaded-files";
import { RowAllocator } from "./row-allocator";
import { SplatTarget } from "./splat-target";
import { PointTextures } from "./textures";

/** Textures of all loaded files. */
export class GpuMemory extends UploadedFiles<PointTextures> {
  readonly target: SplatTarget;
  private readonly rows = new RowAllocator();

  constructor(private readonly gl: WebGL2RenderingContext) {
    super();
    this.target = new SplatTarget(gl);
  }

  delete(): void {
    for (const textures of this.all) textures.delete();
    this.target.delete();
  }

  protected free(textures: PointTextures): void {
    this.rows.give(textures.firstRow, rowsOf(textures.count));
    textures.delete();
  }

  protected upload(file: DecodedFile): PointTextures {
    const firstRow = this.rows.take(rowsOf(file.points.count));
    this.target.reserve(this.rows.end);
    return new PointTextures(this.gl, firstRow, file.points, file.kind === "group" ? file.offsets : null);
  }
}
