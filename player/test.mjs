// Runs tests/**/*.test.ts under node's own test runner: node test.mjs [--coverage] [part of a file's name ...].
// Writes out/tests.json: each file's tests, what failed and why, and with --coverage the lines of src that the tests ran.
import { build } from "esbuild";
import { mkdirSync, mkdtempSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, relative } from "node:path";
import { run } from "node:test";
import { spec } from "node:test/reporters";
import { fileURLToPath } from "node:url";
import { assembly } from "./assembly.mjs";
import { coverageOf } from "./coverage.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = mkdtempSync(join(tmpdir(), "splatreel-tests-"));
const covers = process.argv.includes("--coverage");
const parts = process.argv.slice(2).filter((part) => !part.startsWith("--"));
const names = readdirSync(join(here, "tests"), { recursive: true })
  .filter((name) => name.endsWith(".test.ts") && (parts.length === 0 || parts.some((part) => name.includes(part))))
  .sort();
const options = { absWorkingDir: here, bundle: true, plugins: [assembly], external: ["./player.js"], loader: { ".css": "text", ".svg": "text" }, format: "esm", platform: "node", target: "node20", logLevel: "warning" };
try {
  const [bundles, traces] = [join(out, "bundles"), join(out, "coverage")];
  await build({ ...options, entryPoints: names.map((name) => join("tests", name)), outbase: "tests", outdir: bundles, outExtension: { ".js": ".mjs" }, sourcemap: "linked" });
  const results = await tested(names, bundles, traces);
  const coverage = covers ? await coverageOf(join(here, "src"), bundles, traces, options) : null;
  mkdirSync(join(here, "out"), { recursive: true });
  writeFileSync(join(here, "out/tests.json"), JSON.stringify({ files: results, coverage }, null, 1));
  if (coverage && parts.length === 0) console.log(coverage.line);
} finally {
  rmSync(out, { recursive: true });
}

/** Run the bundles, each in a process of its own; by file, how many tests passed and what failed. */
async function tested(names, bundles, traces) {
  if (covers) process.env.NODE_V8_COVERAGE = traces;
  process.env.NODE_OPTIONS = `${process.env.NODE_OPTIONS ?? ""} --enable-source-maps`;
  process.chdir(here);
  const results = Object.fromEntries(names.map((name) => [name, { passed: 0, failed: [] }]));
  // Source maps give the name before bundling; a file that fails as a whole has the name of its bundle.
  const fileOf = ({ file }) => results[file.endsWith(".ts") ? relative(join(here, "tests"), file) : relative(bundles, file).replace(/\.mjs$/, ".ts")];
  const stream = run({ files: names.map((name) => join(bundles, name.replace(/\.ts$/, ".mjs"))), concurrency: true });
  stream.on("test:pass", (test) => void (test.nesting === 0 && fileOf(test).passed++));
  stream.on("test:fail", (test) => {
    process.exitCode = 1;
    const error = test.details.error?.cause ?? test.details.error;
    if (test.nesting === 0) fileOf(test).failed.push(`${test.name}: ${error?.stack ?? error}`);
  });
  const report = stream.compose(spec);
  report.pipe(process.stdout);
  await new Promise((resolve) => report.on("end", resolve));
  return results;
}
