/** The hot loops of decoding, in plain JavaScript; wasm.ts has the same in WebAssembly, with equal results. */
import { decodeRows, decodeTexture, type Form, type Klt, type Texture } from "./klt";
import { decodeLod, levelsOf, type Levels } from "./lod-prediction";

/** The hot loops of the predictive codec. */
export interface Kernels {
  levelsOf(quantized: Float64Array): Levels;
  decodeLod(data: Uint8Array, columns: number, levels: Levels, shifts: Uint8Array): Int32Array;
  decodeRows(klt: Klt): Float32Array;
  decodeTexture(klt: Klt, form: Form): Texture;
}

export const plain: Kernels = { levelsOf, decodeLod, decodeRows, decodeTexture };
