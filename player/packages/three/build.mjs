// Bundles the three.js object into dist: node build.mjs.
import { build } from "esbuild";
import { writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { common, leaveAddresses, notices, writeDecoders } from "../../bundling.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "dist");

await writeDecoders(out);
const entryPoints = { three: join(here, "src/index.ts"), "sort-worker": "packages/renderer/src/draw/sort-worker.ts" };
await build({ ...common, entryPoints, external: ["three"], outdir: out });
await leaveAddresses(join(out, "three.js"));
await writeFile(
  join(out, "THIRD_PARTY.txt"),
  await notices(
    "The object in this folder is part of Splatreel (Apache-2.0). It carries two decoders of others, which are loaded on demand:",
  ),
);
