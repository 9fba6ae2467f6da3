/** Sorting of visible points far to near. Static and dynamic points are sorted separately and then merged. */
import type { Frustum } from "./frustum";
import { NO_POINT, TEXTURE_WIDTH } from "./texture-layout";

/** Positions of a layer. */
export interface SortableLayer {
  /** Index of the first point in the draw order. */
  base: number;
  means: Float32Array;
  /** [N] radii of the splats, in world units. */
  radii: Float32Array;
}

/** Positions and offsets of a group. */
export interface SortableGroup {
  base: number;
  means: Float32Array;
  radii: Float32Array;
  frames: number;
  /** [T, N, 4] as in Offsets; empty if the group has no dynamic points. */
  dx: Uint16Array;
  dxMin: number[];
  dxStep: number[];
}

/** Collects points with their depths and sorts them. Its buffers are reused. */
export class DepthRun {
  ids = new Uint32Array(0);
  depths = new Float32Array(0);
  count = 0;

  private spareIds = new Uint32Array(0);
  private spareDepths = new Float32Array(0);
  private keys = new Uint16Array(0);
  private starts = new Uint32Array(0);

  /** Remove all points and reserve memory for `capacity`. */
  reset(capacity: number): void {
    this.count = 0;
    if (this.ids.length >= capacity) return;
    [this.ids, this.spareIds] = [new Uint32Array(capacity), new Uint32Array(capacity)];
    [this.depths, this.spareDepths] = [new Float32Array(capacity), new Float32Array(capacity)];
    this.keys = new Uint16Array(capacity);
  }

  /** Add the visible points of a layer whose flag is not 0. */
  addLayer({ means, radii, base }: SortableLayer, flags: Uint8Array, frustum: Frustum): void {
    const view = { ...frustum, near: frustum.clear };
    for (let i = 0, at = 0; at < means.length; i++, at += 3) {
      if (flags[i] === 0) continue;
      this.add(base + i, means[at], means[at + 1], means[at + 2], radii[i], view);
    }
  }

  /** Add the visible points of a group at a frame, counted from its first. */
  addGroup({ means, radii, base, frames, dx, dxMin, dxStep }: SortableGroup, frame: number, view: Frustum): void {
    const count = means.length / 3;
    const low = Math.floor(frame);
    const between = frame - low;
    const [minX, minY, minZ] = dxMin;
    const [stepX, stepY, stepZ] = dxStep;
    for (
      let i = 0, at = 0, a = 4 * count * low, b = 4 * count * Math.min(low + 1, frames - 1);
      i < count;
      i++, at += 3, a += 4, b += 4
    ) {
      const x = means[at] + minX + stepX * (dx[a] + (dx[b] - dx[a]) * between);
      const y = means[at + 1] + minY + stepY * (dx[a + 1] + (dx[b + 1] - dx[a + 1]) * between);
      const z = means[at + 2] + minZ + stepZ * (dx[a + 2] + (dx[b + 2] - dx[a + 2]) * between);
      this.add(base + i, x, y, z, radii[i], view);
    }
  }

  /** Sort far to near by counting, with about one point per bin and at most 2^16 bins. */
  sort(): void {
    const { ids, depths, keys, count, spareIds, spareDepths } = this;
    const bins = 2 ** Math.min(Math.max(Math.round(Math.log2(count)), 10), 16);
    if (this.starts.length <= bins) this.starts = new Uint32Array(bins + 1);
    const { starts } = this;
    let least = Infinity;
    let most = -Infinity;
    for (let i = 0; i < count; i++) {
      if (depths[i] < least) least = depths[i];
      if (depths[i] > most) most = depths[i];
    }
    const factor = most > least ? (bins - 1) / (most - least) : 0;
    starts.fill(0);
    for (let i = 0; i < count; i++) {
      keys[i] = (most - depths[i]) * factor;
      starts[1 + keys[i]]++;
    }
    for (let b = 1; b <= bins; b++) starts[b] += starts[b - 1];
    for (let i = 0; i < count; i++) {
      const at = starts[keys[i]]++;
      spareIds[at] = ids[i];
      spareDepths[at] = depths[i];
    }
    [this.ids, this.spareIds, this.depths, this.spareDepths] = [spareIds, ids, spareDepths, depths];
  }

  private add(
    id: number,
    x: number,
    y: number,
    z: number,
    radius: number,
    { viewmat: m, near, left, right, top, bottom, reachX, reachY }: Frustum,
  ): void {
    const depth = m[8] * x + m[9] * y + m[10] * z + m[11];
    if (!(depth >= near)) return;
    const across = m[0] * x + m[1] * y + m[2] * z + m[3];
    const spareX = radius * reachX;
    if (across - right * depth > spareX || left * depth - across > spareX) return;
    const down = m[4] * x + m[5] * y + m[6] * z + m[7];
    const spareY = radius * reachY;
    if (down - bottom * depth > spareY || top * depth - down > spareY) return;
    this.ids[this.count] = id;
    this.depths[this.count++] = depth;
  }
}

/** Merge two sorted runs into whole rows. buffer: reused for the result if it is large enough. */
export function merge(a: DepthRun, b: DepthRun, buffer: Uint32Array | null): { order: Uint32Array; count: number } {
  const count = a.count + b.count;
  const order = buffer && buffer.length >= rounded(count) ? buffer : new Uint32Array(rounded(1.25 * count));
  let [i, j, at] = [0, 0, 0];
  const { ids: aIds, depths: aDepths } = a;
  const { ids: bIds, depths: bDepths } = b;
  while (i < a.count && j < b.count) order[at++] = aDepths[i] >= bDepths[j] ? aIds[i++] : bIds[j++];
  order.set(aIds.subarray(i, a.count), at);
  order.set(bIds.subarray(j, b.count), at + a.count - i);
  order.fill(NO_POINT, count, rounded(count));
  return { order, count };
}

/** Return the number of entries in the rows of `count` points. */
function rounded(count: number): number {
  return Math.ceil(count / TEXTURE_WIDTH) * TEXTURE_WIDTH;
}
