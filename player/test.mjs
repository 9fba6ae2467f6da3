// Runs tests/**/*.test.ts under Node's own test runner: node test.mjs [part of a file's name ...].
// Started as `npm run coverage`, it also measures the lines of the packages that the tests run.
// Writes out/tests.json: passed and failed tests per file, and the coverage. Fails if the coverage is below LEAST_COVERAGE.
import { mkdirSync, mkdtempSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, relative } from "node:path";
import { run } from "node:test";
import { spec } from "node:test/reporters";
import { fileURLToPath, pathToFileURL } from "node:url";
import { compileAssembly } from "./assembly.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = mkdtempSync(join(tmpdir(), "splatreel-tests-"));
const parts = process.argv.slice(2);
/** Percentage of lines that the unit tests must run. Raise it when the coverage has risen. */
const LEAST_COVERAGE = 80;
const names = readdirSync(join(here, "tests"), { recursive: true })
  .filter((name) => name.endsWith(".test.ts") && (parts.length === 0 || parts.some((part) => name.includes(part))))
  .sort();
try {
  process.chdir(here);
  process.env.SPLATREEL_KERNELS = join(out, "kernels.wasm");
  writeFileSync(process.env.SPLATREEL_KERNELS, await compileAssembly(join(here, "packages/decoder/wasm/kernels.wasm")));
  process.env.NODE_OPTIONS = `${process.env.NODE_OPTIONS ?? ""} --enable-source-maps --import ${pathToFileURL(join(here, "loader.mjs"))}`;
  const results = await runTests();
  mkdirSync(join(here, "out"), { recursive: true });
  writeFileSync(join(here, "out/tests.json"), JSON.stringify(results, null, 1));
  if (results.coverage) console.log(results.coverage.line);
  if (
    results.coverage &&
    parts.length === 0 &&
    results.coverage.covered < (results.coverage.lines * LEAST_COVERAGE) / 100
  ) {
    console.error(`The unit tests must run at least ${LEAST_COVERAGE} % of the lines.`);
    process.exitCode = 1;
  }
} finally {
  rmSync(out, { recursive: true });
}

/** Run each file in a process of its own. Returns passed and failed tests per file, and the coverage, if it is measured. */
async function runTests() {
  const files = Object.fromEntries(names.map((name) => [name, { passed: 0, failed: [] }]));
  let coverage = null;
  const fileOf = ({ file }) => files[relative(join(here, "tests"), file)];
  const stream = run({ files: names.map((name) => join(here, "tests", name)), concurrency: true });
  stream.on("test:pass", (test) => void (test.nesting === 0 && fileOf(test).passed++));
  stream.on("test:fail", (test) => {
    process.exitCode = 1;
    const error = test.details.error?.cause ?? test.details.error;
    if (test.nesting === 0) fileOf(test).failed.push(`${test.name}: ${error?.stack ?? error}`);
  });
  stream.on("test:coverage", ({ summary }) => (coverage = coverageOf(summary)));
  const report = stream.compose(spec);
  report.pipe(process.stdout);
  await new Promise((resolve) => report.on("end", resolve));
  return { files, coverage };
}

/** Reduce Node's coverage summary to the files of the packages: counts, the lines that no test runs, and a line for people. */
function coverageOf({ files }) {
  const source = files.filter(({ path }) => /^packages\/\w+\/src\//.test(relative(here, path)));
  const sum = (key) => source.reduce((total, file) => total + file[key], 0);
  const [lines, covered] = [sum("totalLineCount"), sum("coveredLineCount")];
  const missed = Object.fromEntries(
    source.map(({ path, lines: counts }) => [
      relative(here, path),
      counts.filter(({ count }) => count === 0).map(({ line }) => line),
    ]),
  );
  return {
    lines,
    covered,
    missed,
    line: `TypeScript coverage: ${Math.round((100 * covered) / lines)} % of ${lines} lines (unit tests)`,
  };
}
