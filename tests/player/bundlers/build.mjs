// Builds app/, a page that imports the player, in the manner of each bundler's own documentation: node build.mjs BUNDLER, into
// app/dist. `node build.mjs vite-dev` serves it instead, and writes the address as its first line. `node build.mjs vite-ssr` prints
// the HTML that React renders on a server.
import { cp, readdir } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const app = join(dirname(fileURLToPath(import.meta.url)), "app");
const dist = join(app, "dist");
const entry = join(app, "main.js");
const page = () => cp(join(app, "index.html"), join(dist, "index.html"));

/** Bundlers that do not follow `new URL(name, import.meta.url)` need workers and decoders beside what they write. */
async function copyWorkers() {
  const player = join(app, "node_modules/splatreel-player/dist");
  for (const name of await readdir(player)) if (/-(worker|decode)\.js$|\.wasm$/.test(name)) await cp(join(player, name), join(dist, name));
}

const bundlers = {
  async vite() {
    const { build } = await import("vite");
    await build({ root: app, logLevel: "warn" });
  },
  async "vite-dev"() {
    const { createServer } = await import("vite");
    const server = await createServer({ root: app, logLevel: "warn", server: { host: "127.0.0.1", port: 0 } });
    await server.listen();
    console.log(server.resolvedUrls.local[0]);
  },
  /** Render app/server.jsx on the server, and print the HTML. */
  async "vite-ssr"() {
    const { createServer } = await import("vite");
    const server = await createServer({ root: app, logLevel: "warn", appType: "custom", server: { middlewareMode: true, ws: false } });
    const { render } = await server.ssrLoadModule("/server.jsx");
    console.log(render());
    await server.close();
  },
  async webpack() {
    const { default: webpack } = await import("webpack");
    const options = { mode: "production", context: app, entry, output: { path: dist, filename: "main.js" }, performance: false };
    const stats = await new Promise((resolve, reject) => webpack(options, (error, result) => (error ? reject(error) : resolve(result))));
    if (stats.hasErrors() || stats.hasWarnings()) throw new Error(stats.toString({ all: false, errors: true, warnings: true }));
    await page();
  },
  async esbuild() {
    const { build } = await import("esbuild");
    await build({ entryPoints: [entry], bundle: true, minify: true, format: "esm", outfile: join(dist, "main.js"), logLevel: "warning" });
    await copyWorkers();
    await page();
  },
  async rollup() {
    const { rollup } = await import("rollup");
    const { nodeResolve } = await import("@rollup/plugin-node-resolve");
    const bundle = await rollup({ input: entry, plugins: [nodeResolve({ browser: true })], onwarn: (warning) => { throw new Error(warning.message); } });
    await bundle.write({ dir: dist, format: "es" });
    await copyWorkers();
    await page();
  },
};

await bundlers[process.argv[2]]();
