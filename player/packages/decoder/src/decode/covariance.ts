/** Shapes stored as the logarithm of the square root of a covariance, six numbers, to rotations and scales (docs/format.md). */

const LARGEST = 126;
const SWEEPS = 12;
const NOTHING = 1e-18;
const ROOT2 = Math.sqrt(2);
const ROOT6 = Math.sqrt(6);

/** Scratch memory: a symmetric matrix xx, xy, xz, yy, yz, zz and a quaternion wxyz. */
const m = new Float64Array(6);
const q = new Float64Array(4);
const [XX, XY, XZ, YY, YZ, ZZ] = [0, 1, 2, 3, 4, 5];
const [X, Y, Z] = [1, 2, 3];

/** Convert numbers [N, 6] to unit quaternions [N, 4] and scales [N, 3]. Python computes exactly the same rotations. */
export function toShapes(numbers: Float64Array): { quats: Float32Array; scales: Float32Array } {
  const count = numbers.length / 6;
  const quats = new Float32Array(4 * count);
  const scales = new Float32Array(3 * count);
  for (let i = 0, n = 0; i < count; i++, n += 6) {
    const size = numbers[n] / ROOT6;
    const across = numbers[n + 1] / ROOT2;
    const along = numbers[n + 2] / ROOT6;
    m[XX] = size - along + across;
    m[YY] = size - along - across;
    m[ZZ] = size + 2 * along;
    m[XY] = numbers[n + 3] / ROOT2;
    m[XZ] = numbers[n + 4] / ROOT2;
    m[YZ] = numbers[n + 5] / ROOT2;
    q.fill(0);
    q[0] = 1;
    diagonalize();
    const norm = Math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (let k = 0; k < 4; k++) quats[4 * i + k] = q[k] / norm;
    scales[3 * i] = power(m[XX]);
    scales[3 * i + 1] = power(m[YY]);
    scales[3 * i + 2] = power(m[ZZ]);
  }
  return { quats, scales };
}

function power(octaves: number): number {
  return 2 ** Math.min(Math.max(octaves, -LARGEST), LARGEST);
}

/** Diagonalize `m` by Jacobi rotations, which accumulate in `q`. */
function diagonalize(): void {
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    const rest = m[XY] * m[XY] + m[XZ] * m[XZ] + m[YZ] * m[YZ];
    const whole = m[XX] * m[XX] + m[YY] * m[YY] + m[ZZ] * m[ZZ];
    if (rest <= NOTHING * whole) return;
    turn(XX, YY, XY, XZ, YZ, X, Y, Z);
    turn(ZZ, XX, XZ, YZ, XY, Z, X, Y);
    turn(YY, ZZ, YZ, XY, XZ, Y, Z, X);
  }
}

/** Rotate about axis c so that `m` is zero at axes a and b. The arguments are the indices of these axes in `m` and `q`. */
function turn(aa: number, bb: number, ab: number, ac: number, bc: number, a: number, b: number, c: number): void {
  const off = m[ab];
  if (off === 0) return;
  const half = (m[bb] - m[aa]) / (2 * off);
  let tangent = 1 / (Math.abs(half) + Math.sqrt(half * half + 1));
  if (half < 0) tangent = -tangent;
  const cosine = 1 / Math.sqrt(tangent * tangent + 1);
  const sine = tangent * cosine;
  m[aa] -= tangent * off;
  m[bb] += tangent * off;
  m[ab] = 0;
  const x = m[ac];
  const y = m[bc];
  m[ac] = cosine * x - sine * y;
  m[bc] = sine * x + cosine * y;
  const w = Math.sqrt((1 + cosine) / 2);
  const v = -sine / (2 * w);
  const qw = q[0];
  const qa = q[a];
  const qb = q[b];
  const qc = q[c];
  q[0] = w * qw - v * qc;
  q[a] = w * qa + v * qb;
  q[b] = w * qb - v * qa;
  q[c] = w * qc + v * qw;
}
