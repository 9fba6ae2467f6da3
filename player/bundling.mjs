// What the builds of all packages share.
import { build } from "esbuild";
import { copyFile, mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { assembly } from "./assembly.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const packages = join(here, "node_modules");

// Decoders stay separate files, which only reels that need them download. An export appended to the script makes it a module.
const decoders = {
  "draco-decode.js": ["draco3d/draco_decoder_nodejs.js", "DracoDecoderModule"],
  "draco_decoder.wasm": ["draco3d/draco_decoder.wasm"],
  "hevc-decode.js": ["@hevcjs/core/wasm/hevc-decode.js", "HEVCDecoderModule"],
  "hevc-decode.wasm": ["@hevcjs/core/wasm/hevc-decode.wasm"],
};

// Shaders are embedded without comments and indentation, which a script's minifier keeps in strings.
const shaders = {
  name: "shaders",
  setup: (build) =>
    build.onLoad({ filter: /shaders\.ts$/ }, async ({ path }) => {
      const text = await readFile(path, "utf8");
      return {
        contents: text
          .replace(/\/\*[^]*?\*\//g, "")
          .replace(/(^|\s)\/\/ .*$/gm, "")
          .replace(/^\s+/gm, "")
          .replace(/ ([=*<>?:,(){}]+) /g, "$1"),
        loader: "ts",
      };
    }),
};

// A file of its own: only pages without crypto.subtle load it.
const digest = {
  name: "digest",
  setup: (build) =>
    build.onResolve({ filter: /^\.\/sha256$/ }, ({ kind }) =>
      kind === "dynamic-import" ? { path: "./sha256.js", external: true } : undefined,
    ),
};

/** Options of esbuild. */
export const common = {
  absWorkingDir: here,
  bundle: true,
  minify: true,
  target: "es2022",
  charset: "utf8",
  legalComments: "none",
  plugins: [assembly, shaders, digest],
  format: "esm",
  logLevel: "warning",
};

/** Empty a folder, and write the workers and third-party decoders into it. */
export async function writeDecoders(out) {
  await rm(out, { recursive: true, force: true });
  await mkdir(out, { recursive: true });
  const sources = "packages/decoder/src/decode";
  await build({
    ...common,
    entryPoints: {
      sha256: "packages/decoder/src/files/sha256.ts",
      "decode-worker": `${sources}/decode-worker.ts`,
      "hevc-worker": `${sources}/hevc-worker.ts`,
      "paper-decode": `${sources}/paper-decode.ts`,
    },
    outdir: out,
  });
  for (const name of ["decode-worker", "hevc-worker", "paper-decode"]) await leaveAddresses(join(out, `${name}.js`));
  for (const [name, [source, exported]] of Object.entries(decoders)) {
    if (exported)
      await writeFile(
        join(out, name),
        `${await readFile(join(packages, source), "utf8")}\nexport default ${exported};\n`,
      );
    else await copyFile(join(packages, source), join(out, name));
  }
}

/** Mark dynamic imports of computed addresses, so that other bundlers leave them alone. Minifying drops such comments. */
export async function leaveAddresses(path) {
  const text = await readFile(path, "utf8");
  await writeFile(
    path,
    text.replace(/\bimport\((?!["'`]|\$\{)/g, "import(/* webpackIgnore: true *//* @vite-ignore */"),
  );
}

/** Return the licenses of third-party code. first: what the folder holds. rest: further paragraphs. */
export async function notices(first, rest = []) {
  return [
    first,
    "",
    "draco-decode.js, draco_decoder.wasm: npm package draco3d, Copyright The Draco Authors, Apache License 2.0.",
    "https://www.apache.org/licenses/LICENSE-2.0",
    "",
    "hevc-decode.js, hevc-decode.wasm: npm package @hevcjs/core, under this licence:",
    "",
    await license("@hevcjs/core"),
    ...rest,
  ].join("\n");
}

/** Return the license of an npm package. */
export function license(name) {
  return readFile(join(packages, name, "LICENSE"), "utf8");
}
