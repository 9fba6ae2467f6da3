// Which lines of the player's source ran, by V8's own counts and esbuild's source maps.
import { build } from "esbuild";
import { readFileSync, readdirSync } from "node:fs";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

/** Not what only closes a block, a comment or an import. */
const CODE = /^(?!\s*(\/\/|\/?\*|import\b)).*\w/;

/**
 * Of all lines of `src` that hold code, those that ran in one of the `bundles`, as NODE_V8_COVERAGE wrote of them to `traces`.
 * What no test loads counts as not run. options: esbuild's. Gives { lines, covered, files, line }, the last for
 * people; of each file, the lines that did not run as `missed`.
 */
export async function coverageOf(src, bundles, traces, options) {
  const code = await linesWithCode(src, options);
  const ran = new Map([...code.keys()].map((name) => [name, new Set()]));
  const isBundle = ({ url }) => url.startsWith(pathToFileURL(bundles).href);
  for (const trace of readdirSync(traces)) {
    const { result } = JSON.parse(readFileSync(join(traces, trace), "utf8"));
    for (const script of result.filter(isBundle)) mark(script, src, code, ran);
  }
  const files = Object.fromEntries([...code].map(([name, lines]) => [name, countsOf([...lines].sort((a, b) => a - b), ran.get(name))]));
  const sum = (key) => Object.values(files).reduce((total, file) => total + file[key], 0);
  const [lines, covered] = [sum("lines"), sum("covered")];
  return { lines, covered, files, line: `TypeScript coverage: ${Math.round((100 * covered) / lines)} % of ${lines} lines (unit tests)` };
}

function countsOf(lines, ran) {
  const missed = lines.filter((line) => !ran.has(line));
  return { lines: lines.length, covered: lines.length - missed.length, missed: missed.map((line) => line + 1) };
}

/** By file, the lines that all of `src` in one bundle has code of: no types, no comments, no imports. */
async function linesWithCode(src, options) {
  const names = readdirSync(src, { recursive: true }).filter((name) => name.endsWith(".ts") && !name.endsWith(".d.ts")).sort();
  const contents = names.map((name) => `import ${JSON.stringify(`./${name}`)};`).join("\n");
  const stdin = { contents, resolveDir: src, loader: "ts" };
  const { outputFiles } = await build({ ...options, stdin, outdir: join(src, "out"), treeShaking: false, external: ["*.js"], sourcemap: "external", write: false });
  const map = JSON.parse(outputFiles.find(({ path }) => path.endsWith(".map")).text);
  const lines = new Map(names.map((name) => [name, new Set()]));
  const texts = new Map(names.map((name) => [name, readFileSync(join(src, name), "utf8").split("\n")]));
  for (const { source, line } of segmentsOf(map)) {
    const name = relative(src, resolve(src, "out", map.sources[source]));
    if (CODE.test(texts.get(name)?.[line] ?? "")) lines.get(name).add(line);
  }
  return lines;
}

/** Add to `ran` what ran of one bundle in one process. */
function mark({ url, functions }, src, code, ran) {
  const path = fileURLToPath(url);
  const text = readFileSync(path, "utf8");
  const map = JSON.parse(readFileSync(`${path}.map`, "utf8"));
  const names = map.sources.map((source) => relative(src, resolve(dirname(path), source)));
  const counts = new Uint8Array(text.length).fill(1);
  // Ranges within others come later, and say more.
  for (const { ranges } of functions) for (const { startOffset, endOffset, count } of ranges) counts.fill(count > 0 ? 1 : 0, startOffset, endOffset);
  const starts = [0];
  for (let at = text.indexOf("\n"); at >= 0; at = text.indexOf("\n", at + 1)) starts.push(at + 1);
  for (const { row, column, source, line } of segmentsOf(map)) {
    if (counts[starts[row] + column] && code.get(names[source])?.has(line)) ran.get(names[source]).add(line);
  }
}

const DIGITS = new Map([..."ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"].map((digit, value) => [digit, value]));

/** What a source map joins: row and column of the bundle, source and its line, all from 0. */
function* segmentsOf({ mappings }) {
  let [source, line] = [0, 0];
  for (const [row, segments] of mappings.split(";").entries()) {
    let column = 0;
    for (const segment of segments ? segments.split(",") : []) {
      const [across, file, down] = numbersOf(segment);
      column += across;
      if (file === undefined) continue;
      source += file;
      line += down;
      yield { row, column, source, line };
    }
  }
}

/** Signed numbers in base 64, five bits a digit, the lowest first. */
function numbersOf(segment) {
  const numbers = [];
  let [value, shift] = [0, 0];
  for (const digit of segment) {
    const bits = DIGITS.get(digit);
    value += (bits & 31) << shift;
    shift += 5;
    if (bits & 32) continue;
    numbers.push(value & 1 ? -(value >> 1) : value >> 1);
    [value, shift] = [0, 0];
  }
  return numbers;
}
