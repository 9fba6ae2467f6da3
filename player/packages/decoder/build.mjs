// Bundles the decoder into dist: node build.mjs.
import { build } from "esbuild";
import { writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { common, leaveAddresses, notices, writeDecoders } from "../../bundling.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "dist");

await writeDecoders(out);
const options = { ...common, absWorkingDir: here, outdir: out };
await build({ ...options, entryPoints: { decoder: "src/index.ts" } });
await build({ ...options, entryPoints: ["src/node.ts", "src/node-worker.ts"], platform: "node" });
await leaveAddresses(join(out, "decoder.js"));
await writeFile(
  join(out, "THIRD_PARTY.txt"),
  await notices(
    "The decoder in this folder is part of Splatreel (Apache-2.0). It carries two decoders of others, which are loaded on demand:",
  ),
);
