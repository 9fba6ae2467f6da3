// Inner loop of run.mjs: node loop.mjs BUNDLE CORPUS SECONDS prints the number of new executions per line; BUNDLE PROGRAM runs one program.
import { createHash } from "node:crypto";
import { ftruncateSync, openSync, readdirSync, readFileSync, statSync, writeFileSync, writeSync } from "node:fs";
import { Session } from "node:inspector";
import { createRequire } from "node:module";
import { join } from "node:path";

const MOST_BYTES = 6e8;
/** Executions per query of the coverage, which is slower than an execution. */
const BATCH = 32;
const [bundle, corpus, seconds] = process.argv.slice(2);
const session = new Session();
session.connect();
const ask = (method, parameters) => {
  let answer;
  session.post(method, parameters, (error, result) => (answer = result ?? { result: [] }));
  return answer;
};
ask("Profiler.enable");
ask("Profiler.startPreciseCoverage", { callCount: true, detailed: true });
const { fuzz } = createRequire(import.meta.url)(bundle);

const seen = new Set();
/** Return the number of newly reached blocks since the last query. remember: mark them as known. */
function news(remember) {
  let count = 0;
  for (const script of ask("Profiler.takePreciseCoverage").result) {
    if (!script.url.endsWith("reader.cjs")) continue;
    for (const { ranges } of script.functions) {
      for (const range of ranges) {
        const key = range.startOffset * 2 ** 24 + range.endOffset;
        if (range.count === 0 || seen.has(key)) continue;
        if (remember) seen.add(key);
        count++;
      }
    }
  }
  return count;
}

const programs = [];
let current;
let told = Date.now();
let untold = 0;
async function execute(program) {
  current ??= openSync(join(corpus, ".current"), "w");
  ftruncateSync(current, 0);
  writeSync(current, program, 0, program.length, 0);
  await fuzz(program);
  untold++;
  if (Date.now() - told < 500) return;
  told = Date.now();
  if (process.memoryUsage().rss > MOST_BYTES) throw new Error("the process takes more than 600 MB");
  tell();
}

function tell() {
  writeSync(1, `${untold} ${process.cpuUsage().user + process.cpuUsage().system} ${seen.size}\n`);
  untold = 0;
}

/** Execute all programs. If they reach new blocks, execute each by itself to find those to keep. */
async function executeAll(batch) {
  for (const program of batch) await execute(program);
  if (news(false) === 0) return;
  for (const program of batch) {
    await execute(program);
    if (news(true) === 0) continue;
    programs.push(program);
    writeFileSync(join(corpus, createHash("sha1").update(program).digest("hex")), program);
  }
}

const random = (below) => Math.floor(Math.random() * below);
/** Return a program with one to four changes: a byte set, inserted or removed, or the tail of another program. */
function mutated(program) {
  let bytes = [...program];
  for (let i = random(4); i >= 0; i--) {
    const at = random(bytes.length + 1);
    const kind = random(5);
    if (kind === 0 && at < bytes.length) bytes[at] = random(256);
    else if (kind === 1) bytes.splice(at, 0, ...Array.from({ length: 1 + random(6) }, () => random(256)));
    else if (kind === 2) bytes.splice(at, 1 + random(3));
    else if (kind === 3 && at < bytes.length) bytes[at] = (bytes[at] + random(2) * 2 - 1) & 255;
    else bytes = [...bytes.slice(0, at), ...programs[random(programs.length)].subarray(1)];
  }
  return Buffer.from(bytes.slice(0, 200));
}

if (statSync(corpus).isFile()) await fuzz(readFileSync(corpus));
else {
  const end = Date.now() + 1000 * Number(seconds);
  await executeAll(Array.from({ length: 10 }, (_, i) => Buffer.of(i)));
  await executeAll(
    readdirSync(corpus)
      .filter((name) => /^[0-9a-f]{40}$/.test(name))
      .map((name) => readFileSync(join(corpus, name))),
  );
  while (Date.now() < end)
    await executeAll(Array.from({ length: BATCH }, () => mutated(programs[random(programs.length)])));
  tell();
}
process.exit(0);
