// Checks @splatreel/decoder against the conformance suite: node conformance/run.mjs [CASE ...].
// It needs the built package: npm run build --workspace @splatreel/decoder, in player/. README.md describes the suite.
import { existsSync, readFileSync } from "node:fs";
import { crc32 } from "node:zlib";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const read = (...path) => JSON.parse(readFileSync(join(here, ...path), "utf8"));
const { openReel } = await import("../player/packages/decoder/dist/node.js");

/** Return the arrays of a case by name: { shape, data }. */
async function arraysOf(name, { times, renditions }) {
  const arrays = {};
  for (const rendition of renditions.length > 0 ? renditions : [undefined]) {
    const prefix = rendition ? `${rendition}:` : "";
    const reel = await openReel(join(here, name), { rendition });
    try {
      await addFiles(read(name, "manifest.json"), (uri) => read(name, uri), reel, prefix, arrays);
      for (const time of times) addPoints(`${prefix}at${time}`, await reel.frame(time), arrays);
    } finally {
      reel.close();
    }
  }
  return arrays;
}

/** Add the arrays of all layers and groups. pageAt: returns a page by its URI. */
async function addFiles(manifest, pageAt, reel, prefix, arrays) {
  const pages = (manifest.pages ?? []).map(({ uri }) => pageAt(uri));
  const groups = [...pages, manifest].flatMap((list) => list.groups);
  const uris = layersOf([manifest, ...pages]);
  for (const [index, { first_frame: first }] of groups.entries()) {
    const number = (manifest.first_group ?? 0) + index;
    await reel.frame(first / manifest.fps); // loads its page
    const { group, layers } = await reel.group(number);
    for (const { uri, file } of layers) addPoints(`${prefix}layer${uris.indexOf(uri)}`, plain(file.points), arrays);
    addGroup(`${prefix}group${number}`, group, arrays);
  }
}

/** Return the URIs of all layers: by group, then those that live longest first. */
function layersOf(lists) {
  const until = (layer) => layer.until ?? Infinity;
  const layers = new Map(lists.flatMap((list) => list.layers.map((layer) => [layer.uri, layer])));
  return [...layers.values()].sort((a, b) => a.group - b.group || (until(a) === until(b) ? 0 : until(b) - until(a))).map(({ uri }) => uri);
}

/** Return points as arrays: the codebook is applied. */
function plain({ count, means, quats, scales, opacities, shBase, shRest, codebook, shDegree }) {
  const bands = (shDegree + 1) ** 2;
  const rest = 3 * (bands - 1);
  const sh = new Float32Array(3 * bands * count);
  for (let i = 0; i < count; i++) {
    sh.set(shBase.subarray(3 * i, 3 * i + 3), 3 * bands * i);
    sh.set(codebook.subarray(rest * shRest[i], rest * (shRest[i] + 1)), 3 * (bands * i + 1));
  }
  return { count, means, quats, scales, opacities, sh, shDegree };
}

function addPoints(prefix, { count, means, quats, scales, opacities, sh, shDegree }, arrays) {
  const shapes = { means: [count, 3], quats: [count, 4], scales: [count, 3], opacities: [count], sh: [count, (shDegree + 1) ** 2, 3] };
  const data = { means, quats, scales, opacities, sh };
  for (const [field, shape] of Object.entries(shapes)) arrays[`${prefix}.${field}`] = { shape, data: data[field] };
}

function addGroup(prefix, { points, alive, offsets, light }, arrays) {
  addPoints(`${prefix}.dynamic`, plain(points), arrays);
  arrays[`${prefix}.alive`] = { shape: [alive.length], data: alive };
  if (light) arrays[`${prefix}.light`] = { shape: [light.length / 3, 3], data: light };
  const { count } = points;
  const frames = offsets?.frames ?? 0;
  const values = (data, min, step, channels) => Float32Array.from({ length: frames * count * channels }, (_, i) => min[i % channels] + step[i % channels] * data[4 * Math.floor(i / channels) + (i % channels)]);
  if (!offsets || count === 0) return;
  const { dx, dxMin, dxStep, dq, dqMin, dqStep, worldly, appearance } = offsets;
  arrays[`${prefix}.dx`] = { shape: [frames, count, 3], data: values(dx, dxMin, dxStep, 3) };
  arrays[`${prefix}.dq`] = { shape: [frames, count, 4], data: rotations(values(dq, dqMin, dqStep, 4), worldly ? points.quats : null) };
  if (appearance) arrays[`${prefix}.shade`] = { shape: [frames, count, 4], data: values(appearance.data, appearance.min, appearance.step, 4) };
}

/** Normalize rotations [T, N, 4]. own [N, 4]: convert rotations about the world's axes to those about the points': q^-1 dq q. */
function rotations(dq, own) {
  const times = ([s, x, y, z], [t, a, b, c]) => [s * t - x * a - y * b - z * c, s * a + x * t + y * c - z * b, s * b - x * c + y * t + z * a, s * c + x * b - y * a + z * t];
  for (let at = 0; at < dq.length; at += 4) {
    let turn = dq.subarray(at, at + 4);
    const size = Math.hypot(...turn) || 1;
    turn = turn.map((value) => value / size);
    const [w, x, y, z] = own ? own.subarray(at % own.length, (at % own.length) + 4) : [1, 0, 0, 0];
    dq.set(times([w, -x, -y, -z], times(turn, [w, x, y, z])), at);
  }
  return dq;
}

/** Return what is wrong with the arrays of a case. */
function differences(expected, arrays) {
  return Object.entries(expected.arrays).flatMap(([name, entry]) => {
    const empty = entry.shape.includes(0);
    const found = arrays[name] ?? (empty ? { shape: entry.shape, data: [] } : null); // groups without points have no offsets
    return found ? mistakes(found, entry, expected.tolerance).map((why) => `${name} ${why}`) : [`${name} is missing`];
  });
}

function mistakes({ shape, data }, entry, tolerance) {
  if (String(shape) !== String(entry.shape)) return [`has the shape ${shape}, expected ${entry.shape}`];
  if ("crc32" in entry) return crc32(data) === entry.crc32 ? [] : [`has the CRC-32 ${crc32(data)}, expected ${entry.crc32}`];
  const index = entry.index ?? entry.values.map((_, i) => i);
  const pairs = entry.values.map((value, i) => [`at ${index[i]}`, data[index[i]], value, Math.max(1, Math.abs(value))]);
  if (entry.means) {
    const mean = (weight) => data.reduce((sum, value, i) => sum + value * weight(i), 0) / data.length;
    const size = data.reduce((sum, value) => sum + Math.max(1, Math.abs(value)), 0) / data.length;
    pairs.push(["mean", mean(() => 1), entry.means[0], size], ["weighted mean", mean((i) => ((7919 * i) % 1009) / 1008), entry.means[1], size]);
  }
  return pairs.filter(([, found, value, size]) => !(Math.abs(found - value) <= tolerance * size + (entry.display ?? 0))).map(([where, found, value]) => `${where} is ${found}, expected ${value}`);
}

/** Return the reason for which a reel of refused.json is refused; null if it is not. */
async function refusalOf({ case: name, manifest: edits, files = {} }) {
  const manifest = read(name, "manifest.json");
  for (const [path, ...value] of edits) {
    const owner = path.slice(0, -1).reduce((part, key) => part[key], manifest);
    if (value.length > 0) owner[path.at(-1)] = value[0];
    else delete owner[path.at(-1)];
  }
  const find = (uri) => {
    if (uri === "manifest.json") return new Blob([JSON.stringify(manifest)]);
    const found = join(here, uri in files ? (files[uri] ?? "nothing") : join(name, uri));
    return existsSync(found) ? new Blob([readFileSync(found)]) : null;
  };
  try {
    for (const rendition of manifest.renditions?.map((entry) => entry.name) ?? [undefined]) {
      const reel = await openReel(find, { rendition });
      try {
        await addFiles(manifest, (uri) => read(name, uri), reel, "", {});
      } finally {
        reel.close();
      }
    }
    return null;
  } catch (error) {
    if (error.name !== "ReelError") throw error;
    return error.message;
  }
}

let failed = 0;
const [cases, refused, wanted] = [read("cases.json"), read("refused.json"), process.argv.slice(2)];
const isWanted = (name) => wanted.length === 0 || wanted.includes(name);
for (const name of Object.keys(refused).filter(isWanted)) {
  const reason = await refusalOf(refused[name]);
  failed += reason === null;
  console.log(reason === null ? `${name} is not refused: ${refused[name].covers}` : `${name} is refused: ${reason}`);
}
for (const name of Object.keys(cases).filter(isWanted)) {
  const expected = read(name, "expected.json");
  const wrong = differences(expected, await arraysOf(name, expected));
  failed += wrong.length > 0;
  console.log(wrong.length > 0 ? wrong.map((line) => `${name}: ${line}`).join("\n") : `${name}: ${Object.keys(expected.arrays).length} arrays are right`);
}
process.exitCode = failed > 0 ? 1 : 0;
