/** Far-to-near order of the points that show, by a counting sort of their depths. */

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

const BINS = 1 << 16;

/** Collects points with their depths, then sorts them. Its buffers grow as needed and are used again. */
export class DepthSorter {
  private ids = new Uint32Array(0);
  private depths = new Float32Array(0);
  private count = 0;
  private readonly starts = new Uint32Array(BINS + 1);

  reset(capacity: number): void {
    this.count = 0;
    if (this.ids.length >= capacity) return;
    this.ids = new Uint32Array(capacity);
    this.depths = new Float32Array(capacity);
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

  private add(id: number, depth: number): void {
    this.ids[this.count] = id;
    this.depths[this.count++] = depth;
  }

  /** Write the order, far to near, into a buffer that is large enough; returns it and how many points there are. */
  sort(buffer: Uint32Array | null): { order: Uint32Array; count: number } {
    const { ids, depths, count, starts } = this;
    const order = buffer && buffer.length >= count ? buffer : new Uint32Array(Math.ceil(count * 1.25));
    let least = Infinity;
    let most = -Infinity;
    for (let i = 0; i < count; i++) {
      if (depths[i] < least) least = depths[i];
      if (depths[i] > most) most = depths[i];
    }
    const factor = most > least ? (BINS - 1) / (most - least) : 0;
    starts.fill(0);
    for (let i = 0; i < count; i++) starts[1 + (((most - depths[i]) * factor) | 0)]++;
    for (let b = 1; b <= BINS; b++) starts[b] += starts[b - 1];
    for (let i = 0; i < count; i++) order[starts[((most - depths[i]) * factor) | 0]++] = ids[i];
    return { order, count };
  }
}
