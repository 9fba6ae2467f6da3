// Bundles the player into one folder of static files: node build.mjs [output folder].
import { build, transform } from "esbuild";
import { copyFile, readFile, writeFile } from "node:fs/promises";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { common, leaveAddresses, license, notices, writeDecoders } from "./bundling.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = resolve(process.argv[2] ?? join(here, "../src/splatreel/play/static"));

// Parts loaded on demand, by a literal that other bundlers find: `import("./share.js")`.
const parts = {
  about: "packages/element/src/ui/about.ts",
  annotations: "packages/element/src/ui/annotations.ts",
  "context-menu": "packages/element/src/ui/context-menu.ts",
  "declared-camera": "packages/element/src/ui/declared-camera.ts",
  dialog: "packages/element/src/ui/dialog.ts",
  "file-drop": "packages/element/src/ui/file-drop.ts",
  headset: "packages/element/src/player/headset.ts",
  help: "packages/element/src/ui/help.ts",
  "media-controls": "packages/element/src/ui/media-controls.ts",
  menu: "packages/element/src/ui/menu.ts",
  ...Object.fromEntries(
    ["ar", "de", "es", "fr", "ja", "pt", "zh"].map((name) => [
      `language-${name}`,
      `packages/element/src/languages/language-${name}.ts`,
    ]),
  ),
  "open-files": "packages/element/src/files/open-files.ts",
  panels: "packages/element/src/ui/panels.ts",
  "path-panel": "packages/element/src/ui/path-panel.ts",
  "edit-panel": "packages/element/src/ui/edit-panel.ts",
  screenshot: "packages/element/src/ui/screenshot.ts",
  section: "packages/element/src/ui/section.ts",
  share: "packages/element/src/ui/share.ts",
  statistics: "packages/element/src/ui/statistics.ts",
  "text-tracks": "packages/element/src/ui/text-tracks.ts",
  thumbnails: "packages/element/src/ui/thumbnails.ts",
  "walk-mode": "packages/element/src/ui/walk-mode.ts",
};
const late = {
  name: "late",
  setup: (build) =>
    build.onResolve({ filter: /^\.{1,2}\// }, ({ kind, path }) => {
      const name = path.split("/").at(-1);
      return kind === "dynamic-import" && name in parts ? { path: `./${name}.js`, external: true } : undefined;
    }),
};

// Styles are embedded as minified text. The unit dp is a length that grows with the element (ui.css).
const styles = {
  name: "styles",
  setup: (build) =>
    build.onLoad({ filter: /\.css$/ }, async ({ path }) => {
      const { code } = await transform(await readFile(path, "utf8"), { loader: "css", minify: true });
      return { contents: code.trim().replace(/(-?[\d.]+)dp\b/g, "calc($1*var(--splatreel-dp))"), loader: "text" };
    }),
};

const options = { ...common, plugins: [...common.plugins, late, styles], loader: { ".svg": "text" } };

await writeDecoders(out);
await build({
  ...options,
  entryPoints: { player: "packages/element/src/main.ts", "sort-worker": "packages/renderer/src/draw/sort-worker.ts" },
  outdir: out,
});
// The page that tests the player on a phone loads the player beside it.
await build({ ...options, entryPoints: { "self-test": "packages/element/src/self-test/self-test.ts" }, outdir: out });
await copyFile(join(here, "packages/element/src/self-test/self-test.html"), join(out, "self-test.html"));
// Each part is self-contained, so that it can be embedded in a page.
await build({ ...options, entryPoints: parts, outdir: out });
for (const name of ["player", ...Object.keys(parts)]) await leaveAddresses(join(out, `${name}.js`));
await writeFile(join(out, "index.html"), await page());
const uqr = [
  "share.js: holds the npm package uqr, which writes QR codes, under this licence:",
  "",
  await license("uqr"),
];
await writeFile(
  join(out, "THIRD_PARTY.txt"),
  await notices(
    "The player in this folder is part of Splatreel (Apache-2.0). It carries two decoders and an encoder of others:",
    uqr,
  ),
);

/** Return the bundled page. Its first script is inline, since a separate file would cost a round trip. */
async function page() {
  const first = {
    ...options,
    entryPoints: ["packages/element/src/element/page-prefetch.ts"],
    external: ["./player.js"],
    write: false,
  };
  const early = (await build(first)).outputFiles[0].text.trim();
  const html = await readFile(join(here, "packages/element/src/element/index.html"), "utf8");
  return html.replace("<script data-early></script>", () => `<script type="module" data-early>${early}</script>`);
}
