// Writes the types of a package into the folder types of its dist, and its license into dist: node types.mjs [folder of the package] [another dist].
// Imports of other packages of the workspace become relative, so that the types need no other package, and get the ending .js.
import { execFileSync } from "node:child_process";
import { copyFileSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, relative, resolve, sep } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const folder = resolve(process.argv[2] ?? here);
const dist = resolve(process.argv[3] ?? join(folder, "dist"));
const out = join(dist, "types");
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
  const text = readFileSync(path, "utf8").replace(
    /\b(from |import ?\(?)"((?:@splatreel|\.{1,2})\/[^"]+)"/g,
    (_, word, given) => {
      const source = compilerOptions.paths[given];
      const target = source ? relative(dirname(path), join(out, source[0].replace(/\.ts$/, ""))) : given;
      // Node's resolution (node16, nodenext) reads relative addresses as they are.
      return `${word}"${target
        .split(sep)
        .join("/")
        .replace(/^(?!\.)/, "./")}.js"`;
    },
  );
  writeFileSync(path, text);
}
if (folder === here) copyFileSync(join(here, "react.d.ts"), join(out, "react.d.ts"));
copyFileSync(join(here, "../LICENSE"), join(dist, "LICENSE"));
