// The inside of run.mjs: node loop.mjs BUNDLE CORPUS SECONDS, one line on stdout an execution; or BUNDLE PROGRAM, just that one.
import { createHash } from "node:crypto";
import { readdirSync, readFileSync, statSync, writeFileSync, writeSync } from "node:fs";
import { Session } from "node:inspector";
import { createRequire } from "node:module";
import { join } from "node:path";

const MOST_BYTES = 3e9;
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
/** How many (block, power of two of how often it ran) the execution has reached first. */
function news() {
  let count = 0;
  for (const script of ask("Profiler.takePreciseCoverage").result) {
    if (!script.url.endsWith("reader.cjs")) continue;
    for (const { ranges } of script.functions) {
      for (const range of ranges) {
        const key = `${range.startOffset}-${range.endOffset}-${Math.ceil(Math.log2(range.count + 1))}`;
        if (range.count === 0 || seen.has(key)) continue;
        seen.add(key);
        count++;
      }
    }
  }
  return count;
}

const programs = [];
async function execute(program) {
  writeFileSync(join(corpus, ".current"), program);
  await fuzz(program);
  if (process.memoryUsage().rss > MOST_BYTES) throw new Error("the process takes more than 3 GB");
  writeSync(1, "\n");
  if (news() === 0) return;
  programs.push(program);
  writeFileSync(join(corpus, createHash("sha1").update(program).digest("hex")), program);
}

const random = (below) => Math.floor(Math.random() * below);
/** One to four changes: a byte set, put in or left out, the tail of another program. */
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
  for (let i = 0; i < 10; i++) await execute(Buffer.of(i));
  for (const name of readdirSync(corpus).filter((name) => /^[0-9a-f]{40}$/.test(name))) await execute(readFileSync(join(corpus, name)));
  while (Date.now() < end) await execute(mutated(programs[random(programs.length)]));
}
process.exit(0);
