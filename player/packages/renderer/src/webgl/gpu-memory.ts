/** GPU memory of a reel: the points of its layers and groups. Each file owns rows of the splat target. */
import type { DecodedFile } from "@splatreel/decoder/internal";
import { rowsOf } from "../draw/point-words";
import { UploadedFiles } from "../draw/uploaded-files";
import { SplatTarget } from "./splat-target";
import { PointTextures } from "./textures";

/** First-fit allocator of rows in the splat target. Each file takes a range. */
export class RowAllocator {
  private readonly taken: { first: number; count: number }[] = [];

  /** Allocate `count` rows. Returns the first of them. */
  take(count: number): number {
    let first = 0;
    let at = 0;
    for (; at < this.taken.length && this.taken[at].first - first < count; at++)
      first = this.taken[at].first + this.taken[at].count;
    this.taken.splice(at, 0, { first, count });
    return first;
  }

  /** Free the range that begins at `first`. */
  give(first: number, count: number): void {
    this.taken.splice(
      this.taken.findIndex((range) => range.first === first && range.count === count),
      1,
    );
  }

  /** Number of rows up to the last allocated one. */
  get end(): number {
    const last = this.taken.at(-1);
    return last ? last.first + last.count : 0;
  }
}

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
