// Read numbered SPZ files with the loader of three.js: node spz.mjs LOADER FOLDER. Prints as reel.mjs.
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";

const [loader, folder] = process.argv.slice(2);
const { SPZLoader } = await import(loader);
const peak = () => 1024 * Number(/VmHWM:\s*(\d+)/.exec(readFileSync("/proc/self/status", "utf8"))[1]);
const [cpu, memory] = [process.cpuUsage(), peak()];
const spent = () => Object.values(process.cpuUsage(cpu)).reduce((a, b) => a + b) / 1000;

const spz = new SPZLoader();
for (const name of readdirSync(folder).filter((name) => name.endsWith(".spz")).sort()) {
  const data = readFileSync(join(folder, name));
  await spz.parse(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength));
}
console.log(JSON.stringify({ decode_ms: spent(), all_ms: spent(), memory_bytes: peak() - memory }));
