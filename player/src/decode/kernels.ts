/** The loops that decoding takes its time for, behind one signature each: plain ones here, those of WebAssembly in wasm.ts, which give the same numbers. */
import { decodeRows, decodeTexture, type Form, type Klt, type Texture } from "./klt";
import { decodeLod, levelsOf, type Levels } from "./lod-prediction";

export interface Kernels {
  levelsOf(quantized: Float64Array): Levels;
  decodeLod(data: Uint8Array, columns: number, levels: Levels, shifts: Uint8Array): Int32Array;
  decodeRows(klt: Klt): Float32Array;
  decodeTexture(klt: Klt, form: Form): Texture;
}

export const plain: Kernels = { levelsOf, decodeLod, decodeRows, decodeTexture };
