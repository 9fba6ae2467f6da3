/** The points of a file: every section but the offsets, decoded. */
import type { Container } from "./container";
import { integers, linear, sectionOf, tensor } from "./dequantize";
import { ReelError } from "./errors";
import { mortonOrder } from "./morton";

export interface Gaussians {
  count: number;
  /** [N, 3] */
  means: Float32Array;
  /** [N, 4] wxyz, unit */
  quats: Float32Array;
  /** [N, 3] */
  scales: Float32Array;
  /** [N] */
  opacities: Float32Array;
  /** [N, 3], the DC term */
  shBase: Float32Array;
  /** [N] rows of the codebook */
  shRest: Uint16Array | Uint32Array;
  /** [entries, (degree + 1)^2 - 1, 3] */
  codebook: Float32Array;
  shDegree: number;
}

export type DecodePoints = (bytes: Uint8Array) => Promise<Float32Array>;

export async function decodeGaussians(file: Container, decodePoints: DecodePoints): Promise<Gaussians> {
  const count = file.points;
  if (!(Number.isInteger(count) && count >= 0)) throw new ReelError(`it claims ${count} points`);
  if (count === 0) return empty();
  const rest = file.sections.sh_rest ? await decodeRest(file, count) : { shRest: new Uint16Array(count), codebook: new Float32Array(), shDegree: 0 };
  return {
    count,
    means: await decodeMeans(file, count, decodePoints),
    quats: normalized(await linear(file, "quats", count, 4)),
    scales: await linear(file, "scales", count, 3),
    opacities: await linear(file, "opacities", count, 1),
    shBase: await linear(file, "sh_base", count, 3),
    ...rest,
  };
}

function empty(): Gaussians {
  const none = (): Float32Array => new Float32Array();
  const rest = { shRest: new Uint16Array(), codebook: none(), shDegree: 0 };
  return { count: 0, means: none(), quats: none(), scales: none(), opacities: none(), shBase: none(), ...rest };
}

/** Draco holds lattice points in any order; the reel's order is that of their Morton codes. */
async function decodeMeans(file: Container, count: number, decodePoints: DecodePoints): Promise<Float32Array> {
  const section = sectionOf(file, "means", "draco");
  const lattice = await decodePoints(tensor(file, "means"));
  if (lattice.length !== 3 * count) throw new ReelError(`it holds ${lattice.length / 3} positions of ${count}`);
  const order = mortonOrder(lattice);
  const low = section.min as number[];
  const step = (section.range as number) / (2 ** (section.bits as number) - 1);
  const means = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    for (let a = 0; a < 3; a++) means[3 * i + a] = low[a] + lattice[3 * order[i] + a] * step;
  }
  return means;
}

async function decodeRest(file: Container, count: number): Promise<Pick<Gaussians, "shRest" | "codebook" | "shDegree">> {
  const { entries, bits } = sectionOf(file, "sh_rest", "vq") as unknown as { entries: number; bits: number };
  const shDegree = sectionOf(file, "sh_codebook", "linear").degree as number;
  const shRest = await integers(file, "sh_rest", bits, count);
  if (shRest.some((entry) => entry >= entries)) throw new ReelError(`it names a colour beyond its codebook of ${entries}`);
  return { shRest, shDegree, codebook: await linear(file, "sh_codebook", entries, 3 * ((shDegree + 1) ** 2 - 1)) };
}

function normalized(quats: Float32Array): Float32Array {
  for (let i = 0; i < quats.length; i += 4) {
    const norm = Math.hypot(quats[i], quats[i + 1], quats[i + 2], quats[i + 3]);
    if (norm > 1e-12) for (let a = 0; a < 4; a++) quats[i + a] /= norm;
    else quats.set([1, 0, 0, 0], i);
  }
  return quats;
}
