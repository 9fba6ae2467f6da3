import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { decodeFile, type DecodedFile } from "../packages/decoder/src/decode/decode-file";

const GOLDEN = join(process.cwd(), "../tests/data/golden-predictive");
const manifest = JSON.parse(readFileSync(join(GOLDEN, "manifest.json"), "utf8"));
const expected = JSON.parse(readFileSync(join(GOLDEN, "expected.json"), "utf8"));

const none = (): never => {
  throw new Error("a predictive reel needs neither Draco nor a video decoder");
};
const read = (uri: string): Uint8Array => new Uint8Array(readFileSync(join(GOLDEN, uri)));
const decode = (bytes: Uint8Array): Promise<DecodedFile> => decodeFile(bytes, "a file", none);

function compare(name: string, found: ArrayLike<number>, tolerance: (i: number) => number = () => 0): void {
  const sample = expected.arrays[name] as { shape: number[]; index: number[]; value: number[] };
  assert.equal(
    found.length,
    sample.shape.reduce((a, b) => a * b, 1),
    name,
  );
  sample.index.forEach((at, i) => {
    const slack = expected.tolerance * Math.max(1, Math.abs(sample.value[i])) + tolerance(at);
    assert.ok(
      Math.abs(found[at] - sample.value[i]) <= slack,
      `${name}[${at}]: ${found[at]}, expected ${sample.value[i]}`,
    );
  });
}

/** Rotations [T, N, 4] about the world's axes as those about what the points' own [N, 4] have made of them: q^-1 dq q. */
function local(dq: number[], quats: Float32Array): number[] {
  const times = (a: ArrayLike<number>, b: ArrayLike<number>): number[] => [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3],
    a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1],
  ];
  return Array.from({ length: dq.length / 4 }, (_, i) => {
    const own = quats.subarray((4 * i) % quats.length, ((4 * i) % quats.length) + 4);
    return times(times([own[0], -own[1], -own[2], -own[3]], dq.slice(4 * i, 4 * i + 4)), own);
  }).flat();
}

function comparePoints(prefix: string, { points }: DecodedFile): void {
  for (const name of ["means", "quats", "scales", "opacities"] as const) compare(`${prefix}.${name}`, points[name]);
  const rest = 3 * ((points.shDegree + 1) ** 2 - 1);
  const sh = new Float32Array(points.count * (rest + 3));
  for (let i = 0; i < points.count; i++) {
    sh.set(points.shBase.subarray(3 * i, 3 * i + 3), i * (rest + 3));
    sh.set(points.codebook.subarray(points.shRest[i] * rest, (points.shRest[i] + 1) * rest), i * (rest + 3) + 3);
  }
  compare(`${prefix}.sh`, sh);
}

test("the golden reel decodes to the numbers that Python decodes", async () => {
  for (const [index, entry] of manifest.layers.entries()) comparePoints(`layer${index}`, await decode(read(entry.uri)));
  for (const [index, entry] of manifest.groups.entries()) {
    const file = await decode(read(entry.uri));
    comparePoints(`group${index}.dynamic`, file);
    compare(`group${index}.alive`, file.alive);
    const { dx, dxMin, dxStep, dq, dqMin, dqStep, worldly, appearance } = file.offsets!;
    assert.ok(worldly);
    const plain = (q: ArrayLike<number>, channels: number, min: number[], step: number[]): number[] =>
      Array.from(
        { length: (q.length / 4) * channels },
        (_, i) => min[i % channels] + step[i % channels] * q[4 * Math.floor(i / channels) + (i % channels)],
      );
    compare(`group${index}.dx`, plain(dx, 3, dxMin, dxStep), (i) => dxStep[i % 3] / 2);
    compare(`group${index}.dq`, local(plain(dq, 4, dqMin, dqStep), file.points.quats), () => Math.hypot(...dqStep) / 2);
    assert.equal(appearance !== null, index === 1);
    assert.equal(file.light !== null, index === 1);
    if (file.light) compare(`group${index}.light`, file.light);
    if (appearance)
      compare(
        `group${index}.shade`,
        plain(appearance.data, 4, appearance.min, appearance.step),
        (i) => appearance.step[i % 4] / 2,
      );
  }
});

test("a damaged file soon raises an explained error", async () => {
  const whole = read(manifest.groups[0].uri);
  let seed = 1;
  const random = (below: number): number => (seed = (seed * 48271) % 2147483647) % below;
  let refused = 0;
  for (let run = 0; run < 150; run++) {
    const damaged = whole.slice(0, run % 3 === 0 ? random(whole.length) : whole.length);
    for (let i = 0; i < 3 && damaged.length > 0; i++) damaged[random(damaged.length)] = random(256);
    await decode(damaged).catch((error) => {
      assert.equal(error.name, "ReelError", String(error.stack));
      refused++;
    });
  }
  assert.ok(refused > 100, `${refused} of 150 were refused`);
});
