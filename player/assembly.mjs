// Lets esbuild import FOLDER/NAME.wasm: FOLDER's AssemblyScript, compiled, as a Uint8Array.
import asc from "assemblyscript/asc";
import { readdirSync } from "node:fs";
import { basename, dirname, join, resolve } from "node:path";

const OPTIONS = ["-O3", "--noAssert", "--runtime", "stub", "--enable", "simd", "--use", "abort="];

export const assembly = {
  name: "assembly",
  setup(build) {
    build.onResolve({ filter: /\.wasm$/ }, ({ path, resolveDir }) => ({ path: resolve(resolveDir, path), namespace: "assembly" }));
    build.onLoad({ filter: /./, namespace: "assembly" }, async ({ path }) => {
      const folder = dirname(path);
      const sources = readdirSync(folder).filter((name) => name.endsWith(".ts")).sort();
      let contents;
      const { error, stderr } = await asc.main([...sources, "--baseDir", folder, "--outFile", basename(path), ...OPTIONS], { writeFile: (_, data) => void (contents = data) });
      if (error) return { errors: [{ text: `${error.message}\n${stderr}` }] };
      return { contents, loader: "binary", watchFiles: sources.map((name) => join(folder, name)) };
    });
  },
};
