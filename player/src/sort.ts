/** Far-to-near order of the points that show, by their depths: static and moving ones apart, then merged. */
import { NO_POINT, TEXTURE_WIDTH } from "./layout";

export interface SortableLayer {
  /** Index of the layer's first point among all drawable points, and among the static ones. */
  base: number;
  means: Float32Array;
}

export interface SortableGroup {
  base: number;
  means: Float32Array;
  frames: number;
  /** [T, N, 4] as in Offsets; empty if the group has no dynamic points. */
  dx: Uint16Array;
  dxMin: number[];
  dxStep: number[];
  alive: Uint8Array;
}

/** Depth of a point is dot(axis.xyz, mean) + axis.w, along the camera's forward direction. */
export type DepthAxis = [number, number, number, number];

/** Points with their depths, then far to near. Its buffers grow as needed and are used again. */
export class DepthRun {
  ids = new Uint32Array(0);
  depths = new Float32Array(0);
  count = 0;

  private spareIds = new Uint32Array(0);
  private spareDepths = new Float32Array(0);
  private keys = new Uint16Array(0);
  private starts = new Uint32Array(0);

  /** Forget all points, and make room for some. */
  reset(capacity: number): void {
    this.count = 0;
    if (this.ids.length >= capacity) return;
    [this.ids, this.spareIds] = [new Uint32Array(capacity), new Uint32Array(capacity)];
    [this.depths, this.spareDepths] = [new Float32Array(capacity), new Float32Array(capacity)];
    this.keys = new Uint16Array(capacity);
  }

  /** Static points whose flag is not 0. flags: of this layer's points. */
  addLayer(layer: SortableLayer, flags: Uint8Array | null, axis: DepthAxis, near: number): void {
    const { means, base } = layer;
    const [x, y, z, w] = axis;
    for (let i = 0, at = 0; at < means.length; i++, at += 3) {
      if (flags && flags[i] === 0) continue;
      const depth = x * means[at] + y * means[at + 1] + z * means[at + 2] + w;
      if (depth >= near) this.add(base + i, depth);
    }
  }

  /** A group's dynamic points at a frame counted from its first. */
  addGroup(group: SortableGroup, frame: number, axis: DepthAxis, near: number): void {
    const { means, base, dx } = group;
    const count = means.length / 3;
    const low = Math.floor(frame);
    const between = frame - low;
    const from = 4 * count * low;
    const to = 4 * count * Math.min(low + 1, group.frames - 1);
    const [x, y, z] = axis;
    const w = axis[3] + x * group.dxMin[0] + y * group.dxMin[1] + z * group.dxMin[2];
    const sx = x * group.dxStep[0];
    const sy = y * group.dxStep[1];
    const sz = z * group.dxStep[2];
    for (let i = 0; i < count; i++) {
      const a = from + 4 * i;
      const b = to + 4 * i;
      const before = sx * dx[a] + sy * dx[a + 1] + sz * dx[a + 2];
      const after = sx * dx[b] + sy * dx[b + 1] + sz * dx[b + 2];
      const still = x * means[3 * i] + y * means[3 * i + 1] + z * means[3 * i + 2];
      const depth = still + w + before + (after - before) * between;
      if (depth >= near) this.add(base + i, depth);
    }
  }

  /** Sort far to near, by counting: about four points a bin, at most 2^16 bins. */
  sort(): void {
    const { ids, depths, keys, count, spareIds, spareDepths } = this;
    const bins = 2 ** Math.min(Math.max(Math.round(Math.log2(count / 4)), 10), 16);
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

  private add(id: number, depth: number): void {
    this.ids[this.count] = id;
    this.depths[this.count++] = depth;
  }
}

/** The order of two sorted runs together, in whole rows, in `buffer` if it is large enough; and how many points there are. */
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

/** Entries of the whole rows that `count` points take. */
function rounded(count: number): number {
  return Math.ceil(count / TEXTURE_WIDTH) * TEXTURE_WIDTH;
}
