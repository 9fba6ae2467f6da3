// Writes the types of a package into its dist/types, and its license: node types.mjs [folder of the package].
// Imports of other packages of the workspace become relative, so that the types need no other package.
import { execFileSync } from "node:child_process";
import { copyFileSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, relative, resolve, sep } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const folder = resolve(process.argv[2] ?? here);
const out = join(folder, "dist/types");
const { compilerOptions } = JSON.parse(readFileSync(join(here, "tsconfig.json"), "utf8"));

const tsc = join(here, "node_modules/typescript/bin/tsc");
const project = ["--project", join(folder, "tsconfig.types.json")];
execFileSync(
  process.execPath,
  [tsc, ...project, "--noEmit", "false", "--declaration", "--emitDeclarationOnly", "--rootDir", here, "--outDir", out],
  { stdio: "inherit" },
);
for (const name of readdirSync(out, { recursive: true }).filter((path) => path.endsWith(".d.ts"))) {
  const path = join(out, name);
  const text = readFileSync(path, "utf8").replace(/"(@splatreel\/[^"]+)"/g, (_, name) => {
    const [source] = compilerOptions.paths[name];
    const target = relative(dirname(path), join(out, source.replace(/\.ts$/, "")))
      .split(sep)
      .join("/");
    return JSON.stringify(target.startsWith(".") ? target : `./${target}`);
  });
  writeFileSync(path, text);
}
if (folder === here) copyFileSync(join(here, "react.d.ts"), join(out, "react.d.ts"));
copyFileSync(join(here, "../LICENSE"), join(folder, "dist/LICENSE"));
