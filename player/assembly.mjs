// Compiles AssemblyScript: as a plugin it lets esbuild import FOLDER/NAME.wasm, all sources of FOLDER, as a Uint8Array.
import asc from "assemblyscript/asc";
import { readdirSync } from "node:fs";
import { basename, dirname, join, resolve } from "node:path";

const OPTIONS = ["-O3", "--noAssert", "--runtime", "stub", "--enable", "simd", "--use", "abort="];
const sourcesOf = (folder) =>
  readdirSync(folder)
    .filter((name) => name.endsWith(".ts"))
    .sort();

/** Compile the sources beside `path`. Returns the bytes of the module. */
export async function compileAssembly(path) {
  const folder = dirname(path);
  let contents;
  const { error, stderr } = await asc.main(
    [...sourcesOf(folder), "--baseDir", folder, "--outFile", basename(path), ...OPTIONS],
    { writeFile: (_, data) => void (contents = data) },
  );
  if (error) throw new Error(`${error.message}\n${stderr}`);
  return contents;
}

export const assembly = {
  name: "assembly",
  setup(build) {
    build.onResolve({ filter: /\.wasm$/ }, ({ path, resolveDir }) => ({
      path: resolve(resolveDir, path),
      namespace: "assembly",
    }));
    build.onLoad({ filter: /./, namespace: "assembly" }, async ({ path }) => {
      const watchFiles = sourcesOf(dirname(path)).map((name) => join(dirname(path), name));
      return { contents: await compileAssembly(path), loader: "binary", watchFiles };
    });
  },
};
