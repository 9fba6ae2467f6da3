// Bundles the player into one folder of static files: node build.mjs [output folder].
import { build, transform } from "esbuild";
import { copyFile, mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { assembly } from "./assembly.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = resolve(process.argv[2] ?? join(here, "../src/splatreel/play/static"));
const packages = join(here, "node_modules");

// Decoders stay separate files, which only reels that need them download. An export appended to the script makes it a module.
const decoders = {
  "draco-decode.js": ["draco3d/draco_decoder_nodejs.js", "DracoDecoderModule"],
  "draco_decoder.wasm": ["draco3d/draco_decoder.wasm"],
  "hevc-decode.js": ["@hevcjs/core/wasm/hevc-decode.js", "HEVCDecoderModule"],
  "hevc-decode.wasm": ["@hevcjs/core/wasm/hevc-decode.wasm"],
};

// Parts loaded on demand, by a literal that other bundlers find: `import("./share.js")`.
const parts = {
  "context-menu": "src/ui/context-menu.ts",
  "declared-camera": "src/ui/declared-camera.ts",
  "file-drop": "src/ui/file-drop.ts",
  headset: "src/player/headset.ts",
  help: "src/ui/help.ts",
  "media-controls": "src/ui/media-controls.ts",
  menu: "src/ui/menu.ts",
  "open-files": "src/files/open-files.ts",
  "path-panel": "src/ui/path-panel.ts",
  screenshot: "src/ui/screenshot.ts",
  section: "src/ui/section.ts",
  share: "src/ui/share.ts",
  "text-tracks": "src/ui/text-tracks.ts",
};
const late = {
  name: "late",
  setup: (build) => build.onResolve({ filter: /^\.{1,2}\// }, ({ kind, path }) => {
    const name = path.split("/").at(-1);
    return kind === "dynamic-import" && name in parts ? { path: `./${name}.js`, external: true } : undefined;
  }),
};

// Styles are embedded as minified text.
const styles = {
  name: "styles",
  setup: (build) => build.onLoad({ filter: /\.css$/ }, async ({ path }) => {
    const { code } = await transform(await readFile(path, "utf8"), { loader: "css", minify: true });
    return { contents: code.trim(), loader: "text" };
  }),
};

// Shaders are embedded without comments and indentation, which a script's minifier keeps in strings.
const shaders = {
  name: "shaders",
  setup: (build) => build.onLoad({ filter: /[/\\]shaders\.ts$/ }, async ({ path }) => {
    const text = await readFile(path, "utf8");
    return { contents: text.replace(/\/\*[^]*?\*\//g, "").replace(/(^|\s)\/\/ .*$/gm, "").replace(/^\s+/gm, "").replace(/ ([=*<>?:,(){}]+) /g, "$1"), loader: "ts" };
  }),
};

const common = {
  absWorkingDir: here,
  bundle: true,
  minify: true,
  target: "es2022",
  charset: "utf8",
  legalComments: "none",
  plugins: [assembly, late, shaders, styles],
  loader: { ".svg": "text" },
  logLevel: "warning",
};

await rm(out, { recursive: true, force: true });
await mkdir(out, { recursive: true });
await build({ ...common, entryPoints: { player: "src/main.ts" }, format: "esm", outdir: out });
// Each part is self-contained, so that it can be embedded in a page.
await build({ ...common, entryPoints: parts, format: "esm", outdir: out });
await build({
  ...common,
  entryPoints: {
    "decode-worker": "src/decode/decode-worker.ts",
    "hevc-worker": "src/decode/hevc-worker.ts",
    "sort-worker": "src/draw/sort-worker.ts",
  },
  format: "esm",
  outdir: out,
});
for (const name of ["player", "decode-worker", "hevc-worker"]) await leaveAddresses(join(out, `${name}.js`));
await writeFile(join(out, "index.html"), await page());
for (const [name, [source, exported]] of Object.entries(decoders)) {
  if (exported) await writeFile(join(out, name), `${await readFile(join(packages, source), "utf8")}\nexport default ${exported};\n`);
  else await copyFile(join(packages, source), join(out, name));
}
await writeFile(join(out, "THIRD_PARTY.txt"), await notices());

/** Return the bundled page. Its first script is inline, since a separate file would cost a round trip. */
async function page() {
  const options = { ...common, entryPoints: ["src/element/page-prefetch.ts"], format: "esm", external: ["./player.js"], write: false };
  const early = (await build(options)).outputFiles[0].text.trim();
  const html = await readFile(join(here, "src/element/index.html"), "utf8");
  return html.replace("<script data-early></script>", () => `<script type="module" data-early>${early}</script>`);
}

/** Mark dynamic imports of computed addresses, so that other bundlers leave them alone. Minifying drops such comments. */
async function leaveAddresses(path) {
  const text = await readFile(path, "utf8");
  await writeFile(path, text.replace(/\bimport\((?!["'`]|\$\{)/g, "import(/* webpackIgnore: true *//* @vite-ignore */"));
}

async function notices() {
  const license = (name) => readFile(join(packages, name, "LICENSE"), "utf8");
  return [
    "The player in this folder is part of Splatreel (Apache-2.0). It carries two decoders and an encoder of others:",
    "",
    "draco-decode.js, draco_decoder.wasm: npm package draco3d, Copyright The Draco Authors, Apache License 2.0.",
    "https://www.apache.org/licenses/LICENSE-2.0",
    "",
    "hevc-decode.js, hevc-decode.wasm: npm package @hevcjs/core, under this licence:",
    "",
    await license("@hevcjs/core"),
    "share.js: holds the npm package uqr, which writes QR codes, under this licence:",
    "",
    await license("uqr"),
  ].join("\n");
}
