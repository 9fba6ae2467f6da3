// Module hooks that let Node import the player's sources: TypeScript by esbuild, styles and icons as text, AssemblyScript as bytes.
// Use: node --import ./loader.mjs FILE.ts. test.mjs gives the compiled AssemblyScript in SPLATREEL_KERNELS.
import { transform } from "esbuild";
import { readFileSync } from "node:fs";
import { readFile } from "node:fs/promises";
import { register } from "node:module";
import { fileURLToPath } from "node:url";
import { isMainThread } from "node:worker_threads";

if (isMainThread) register(import.meta.url);

const { compilerOptions } = JSON.parse(readFileSync(new URL("./tsconfig.json", import.meta.url), "utf8"));

export function resolve(specifier, context, next) {
  const [entry] = compilerOptions.paths[specifier] ?? [];
  if (entry) return next(new URL(entry, import.meta.url).href, context);
  const bare =
    specifier.startsWith(".") && context.parentURL?.endsWith(".ts") && !/\.(mjs|js|ts|css|svg|wasm)$/.test(specifier);
  if (!specifier.endsWith(".wasm")) return next(bare ? `${specifier}.ts` : specifier, context);
  return { url: new URL(specifier, context.parentURL).href, shortCircuit: true };
}

export async function load(url, context, next) {
  const kind = url.split(".").at(-1);
  if (!["ts", "css", "svg", "wasm"].includes(kind)) return next(url, context);
  const path = fileURLToPath(url);
  const module = (source) => ({ format: "module", source, shortCircuit: true });
  if (kind === "wasm")
    return module(
      `import { readFileSync } from "node:fs"; export default new Uint8Array(readFileSync(${JSON.stringify(process.env.SPLATREEL_KERNELS)}));`,
    );
  const text = await readFile(path, "utf8");
  if (kind !== "ts") return module(`export default ${JSON.stringify(text)};`);
  return module(
    (await transform(text, { loader: "ts", target: "node20", sourcemap: "inline", sourcefile: path })).code,
  );
}
