/** Kernels in WebAssembly (../wasm): arrays are copied into its memory, and the results copied out. */
import { ReelError } from "../base/errors";
import { streamOf } from "./entropy";
import type { Kernels } from "./kernels";
import { coded, slotsOf, scaleOf, SHARES, type Form, type Klt, type Texture } from "./klt";
import { CONTEXT_OF, CONTEXTS, firstStride, type Levels } from "./lod-prediction";

/** Exports of ../wasm. All functions take addresses and integers. */
interface Module {
  memory: WebAssembly.Memory;
  begin(): number;
  open(
    lookup: number,
    states: number,
    lanes: number,
    words: number,
    wordCount: number,
    raw: number,
    rawBytes: number,
  ): void;
  lod(
    found: number,
    sizes: number,
    contextOf: number,
    order: number,
    neighbours: number,
    weights: number,
    shifts: number,
    ends: number,
    count: number,
    columns: number,
  ): number;
  levels(
    quantized: number,
    count: number,
    firstStride: number,
    order: number,
    neighbours: number,
    weights: number,
  ): void;
  expand(
    found: number,
    ends: number,
    points: number,
    count: number,
    columns: number,
    slots: number,
    rows: number,
    basis: number,
    dimensions: number,
    K: number,
    own: number,
    result: number,
  ): void;
  expandRows(
    found: number,
    ends: number,
    points: number,
    count: number,
    columns: number,
    basis: number,
    dimensions: number,
    result: number,
  ): void;
  turn(values: number, count: number): void;
  color(values: number, count: number, shares: number): void;
  range(values: number, count: number, ranges: number): void;
  quantize(
    values: number,
    frames: number,
    points: number,
    count: number,
    rows: number,
    scale: number,
    stay: number,
    data: number,
    bytes: number,
  ): void;
}

/** Errors by the return value of `lod`. */
const WRONG = [
  "",
  "a stream ends too early",
  "a stream holds numbers that are too large",
  "a section decodes to numbers that are too large",
  "a stream is damaged",
];
const PAGE = 65536;
/** Maximum memory that is kept for the next file. */
const KEPT = 64 * 2 ** 20;

type Numbers = Uint8Array | Uint16Array | Uint32Array | Int32Array | Float32Array | Float64Array;

/** Bump allocator in the memory of a module instance. */
class Arena {
  readonly run: Module;
  private at: number;

  constructor(instance: WebAssembly.Instance) {
    this.run = instance.exports as unknown as Module;
    this.at = this.run.begin();
  }

  get large(): boolean {
    return this.run.memory.buffer.byteLength > KEPT;
  }

  clear(): void {
    this.at = this.run.begin();
  }

  /** Allocate uninitialized bytes. Returns their address. */
  room(bytes: number): number {
    const place = Math.ceil(this.at / 16) * 16;
    this.at = place + bytes;
    const { memory } = this.run;
    // One page more, since vector loads may read beyond the end of an array.
    const missing = this.at + PAGE - memory.buffer.byteLength;
    if (missing > 0) grow(memory, Math.ceil(missing / PAGE));
    return place;
  }

  zeros(bytes: number): number {
    const place = this.room(bytes);
    new Uint8Array(this.run.memory.buffer, place, bytes).fill(0);
    return place;
  }

  put(array: Numbers): number {
    const place = this.room(array.byteLength);
    new Uint8Array(this.run.memory.buffer, place).set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
    return place;
  }

  /** Copy from an address into an array. */
  take<T extends Numbers>(place: number, array: T): T {
    new Uint8Array(array.buffer, array.byteOffset, array.byteLength).set(
      new Uint8Array(this.run.memory.buffer, place, array.byteLength),
    );
    return array;
  }
}

function grow(memory: WebAssembly.Memory, pages: number): void {
  try {
    memory.grow(pages);
  } catch (error) {
    throw new ReelError("it needs more memory than is available", { cause: error });
  }
}

/** Return the kernels of a compiled module. Throws if it cannot be instantiated. */
export function wasmKernels(module: WebAssembly.Module): Kernels {
  const start = (): Arena => new Arena(new WebAssembly.Instance(module, { env: { sin: Math.sin, cos: Math.cos } }));
  let arena = start();
  const fresh = (): Arena => {
    if (arena.large) arena = start();
    arena.clear();
    return arena;
  };
  return {
    levelsOf: (quantized) => levelsOf(fresh(), quantized),
    decodeLod: (data, columns, levels, shifts) => {
      const here = fresh();
      const result = new Int32Array(columns * shifts.length);
      return here.take(lod(here, data, columns, levels, shifts, null).found, result);
    },
    decodeRows: (klt) => decodeRows(fresh(), klt),
    decodeTexture: (klt, form) => decodeTexture(fresh(), klt, form),
  };
}

function levelsOf(arena: Arena, quantized: Float64Array): Levels {
  const count = quantized.length / 3;
  const from = arena.put(Int32Array.from(quantized));
  const [order, neighbours, weights] = [arena.room(4 * count), arena.zeros(16 * count), arena.zeros(8 * count)];
  arena.run.levels(from, count, firstStride(count), order, neighbours, weights);
  return {
    order: arena.take(order, new Uint32Array(count)),
    neighbours: arena.take(neighbours, new Uint32Array(4 * count)),
    weights: arena.take(weights, new Uint16Array(4 * count)),
  };
}

/** Decode the integers [N, columns] of a stream. Returns the addresses of them and of `ends`. */
function lod(
  arena: Arena,
  data: Uint8Array,
  columns: number,
  levels: Levels,
  shifts: Uint8Array,
  ends: Int32Array | null,
): { found: number; ends: number } {
  const stream = streamOf(data, CONTEXTS);
  const count = shifts.length;
  const found = arena.zeros(4 * columns * count);
  const sizes = arena.zeros(2 * columns * count);
  const endsAt = ends ? arena.put(ends) : 0;
  const [lookup, states, words, raw] = [
    arena.put(stream.lookup),
    arena.put(stream.states),
    arena.put(stream.words),
    arena.put(stream.raw),
  ];
  arena.run.open(lookup, states, stream.states.length, words, stream.words.length, raw, stream.rawBytes);
  const [contextOf, order, neighbours, weights] = [
    arena.put(CONTEXT_OF),
    arena.put(levels.order),
    arena.put(levels.neighbours),
    arena.put(levels.weights),
  ];
  const wrong = arena.run.lod(
    found,
    sizes,
    contextOf,
    order,
    neighbours,
    weights,
    arena.put(shifts),
    endsAt,
    count,
    columns,
  );
  if (wrong) throw new ReelError(WRONG[wrong]);
  return { found, ends: endsAt };
}

function decodeRows(arena: Arena, { data, ends, columns, basis, dimensions, levels, shifts }: Klt): Float32Array {
  const K = basis.length / dimensions;
  const at = lod(arena, data, columns.length, levels, shifts, ends);
  const points = coded(ends);
  const result = new Float32Array(points.length * dimensions);
  const across = Float64Array.from(basis, (_, i) => basis[(i % dimensions) * K + Math.floor(i / dimensions)]);
  const [from, transposed, to] = [arena.put(points), arena.put(across), arena.room(result.byteLength)];
  arena.run.expandRows(at.found, at.ends, from, points.length, columns.length, transposed, dimensions, to);
  return arena.take(to, result);
}

function decodeTexture(
  arena: Arena,
  { data, ends, columns, basis, dimensions, levels, shifts }: Klt,
  form: Form,
): Texture {
  const { run } = arena;
  const K = basis.length / dimensions;
  const at = lod(arena, data, columns.length, levels, shifts, ends);
  const { slots, rows } = slotsOf(columns, 4);
  const some = coded(ends);
  const count = some.length * dimensions;
  const [points, basisAt, own, values] = [
    arena.put(some),
    arena.put(basis),
    arena.room(32 * K),
    arena.room(16 * count),
  ];
  run.expand(
    at.found,
    at.ends,
    points,
    some.length,
    columns.length,
    arena.put(slots),
    arena.put(rows),
    basisAt,
    dimensions,
    K,
    own,
    values,
  );
  if (form.turn === "quaternion") run.turn(values, count);
  if (form.turn === "color") run.color(values, count, arena.put(Float64Array.from(SHARES)));
  const ranges = arena.put(Float32Array.from([...form.rest, ...form.rest]));
  run.range(values, count, ranges);
  const [low, high] = [arena.take(ranges, new Float32Array(4)), arena.take(ranges + 16, new Float32Array(4))];
  const { share, stay, step } = scaleOf(low, high, form.rest, form.most);
  const Whole = form.most > 255 ? Uint16Array : Uint8Array;
  const result = new Whole(4 * dimensions * ends.length);
  const [scale, stayAt, to] = [
    arena.put(Float64Array.from([...low, ...share])),
    arena.put(Whole.from(stay)),
    arena.room(result.byteLength),
  ];
  run.quantize(values, dimensions, points, some.length, ends.length, scale, stayAt, to, 4 * Whole.BYTES_PER_ELEMENT);
  return { data: arena.take(to, result), min: [...low], step };
}
