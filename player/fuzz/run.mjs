// Fuzzes the player's decoder, guided by V8's block coverage: node fuzz/run.mjs CORPUS SECONDS, in player/.
// Programs that reach new blocks are kept in CORPUS. One that breaks a rule of reader.ts, or takes 60 s or 600 MB, is kept as
// crash-N, with the reason in crash-N.txt. node fuzz/run.mjs CORPUS/crash-N repeats it.
import { build } from "esbuild";
import { spawn } from "node:child_process";
import {
  existsSync,
  mkdirSync,
  mkdtempSync,
  readdirSync,
  readFileSync,
  rmSync,
  statSync,
  writeFileSync,
} from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { assembly } from "../assembly.mjs";

const PATIENCE = 60;
const here = dirname(fileURLToPath(import.meta.url));
const corpus = resolve(process.argv[2]);
const folder = mkdtempSync(join(tmpdir(), "splatreel-fuzz-"));
const target = join(folder, "reader.cjs");
await build({
  entryPoints: [join(here, "reader.ts")],
  outfile: target,
  bundle: true,
  plugins: [assembly],
  format: "cjs",
  platform: "node",
  target: "node20",
  logLevel: "warning",
});
let executions = 0;
let cpu = 0;
let blocks = 0;
let findings = 0;
const began = Date.now();
if (existsSync(corpus) && statSync(corpus).isFile())
  process.exitCode = await new Promise((done) =>
    spawn("node", [join(here, "loop.mjs"), target, corpus], { stdio: "inherit" }).on("exit", done),
  );
else {
  mkdirSync(corpus, { recursive: true });
  const end = began + 1000 * Number(process.argv[3]);
  while (Date.now() < end) await once(Math.round((end - Date.now()) / 1000));
  const kept = readdirSync(corpus).filter((name) => /^[0-9a-f]{40}$/.test(name)).length;
  console.log(
    `${executions} executions, ${Math.round(cpu)} s of processor time in ${Math.round((Date.now() - began) / 1000)} s, ${blocks} blocks, ${kept} programs, ${findings} findings`,
  );
  process.exitCode = findings ? 1 : 0;
}
rmSync(folder, { recursive: true });

/** Run the loop until it ends with a finding or hangs. */
function once(seconds) {
  return new Promise((done) => {
    const child = spawn(
      "node",
      ["--max-old-space-size=3000", join(here, "loop.mjs"), target, corpus, String(seconds)],
      { stdio: ["ignore", "pipe", "pipe"] },
    );
    let last = Date.now();
    let used = 0;
    let errors = "";
    const found = (why) => {
      const name = join(corpus, `crash-${Date.now()}`);
      writeFileSync(name, readFileSync(join(corpus, ".current")));
      writeFileSync(`${name}.txt`, why);
      console.log(`${name}: ${why.split("\n")[0]}`);
      findings++;
    };
    const watch = setInterval(() => {
      if (Date.now() - last < 1000 * PATIENCE) return;
      clearInterval(watch);
      found("timeout");
      child.kill("SIGKILL");
    }, 1000);
    child.stdout.on("data", (data) => {
      last = Date.now();
      for (const line of data.toString().trim().split("\n")) {
        const [more, microseconds, reached] = line.split(" ").map(Number);
        executions += more;
        used = microseconds / 1e6;
        blocks = reached;
      }
    });
    child.stderr.on("data", (data) => (errors += data));
    child.on("exit", (code) => {
      clearInterval(watch);
      cpu += used;
      if (code) found(errors || `exit code ${code}`);
      done();
    });
  });
}
