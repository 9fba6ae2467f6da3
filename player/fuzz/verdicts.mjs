// Reads reels with the player's decoder: node fuzz/verdicts.mjs FOLDER. Prints what is wrong with each reel in FOLDER, null for nothing, as JSON.
import { build } from "esbuild";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { assembly } from "../assembly.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const folder = mkdtempSync(join(tmpdir(), "splatreel-verdicts-"));
const outfile = join(folder, "verdicts.mjs");
try {
  await build({
    entryPoints: [join(here, "verdicts.ts")],
    outfile,
    bundle: true,
    plugins: [assembly],
    format: "esm",
    platform: "node",
    target: "node20",
    logLevel: "warning",
  });
  const { verdictsOf } = await import(pathToFileURL(outfile).href);
  console.log(JSON.stringify(await verdictsOf(process.argv[2])));
} finally {
  rmSync(folder, { recursive: true });
}
