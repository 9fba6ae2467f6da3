// Bundles the script of PlayCanvas into dist: node build.mjs.
import { build } from "esbuild";
import { writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { common, leaveAddresses, notices, writeDecoders } from "../../bundling.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "dist");

await writeDecoders(out);
await build({
  ...common,
  entryPoints: { playcanvas: join(here, "src/index.ts") },
  external: ["playcanvas"],
  outdir: out,
});
await leaveAddresses(join(out, "playcanvas.js"));
await writeFile(
  join(out, "THIRD_PARTY.txt"),
  await notices(
    "The script in this folder is part of Splatreel (Apache-2.0). It carries two decoders of others, which are loaded on demand:",
  ),
);
