// Decode a reel: node reel.mjs DECODER REEL. Prints processor milliseconds and bytes of memory as JSON.
import { readFileSync } from "node:fs";

const [decoder, folder] = process.argv.slice(2);
const { openReel } = await import(decoder);
const peak = () => 1024 * Number(/VmHWM:\s*(\d+)/.exec(readFileSync("/proc/self/status", "utf8"))[1]);
const [cpu, memory] = [process.cpuUsage(), peak()];
const spent = () => Object.values(process.cpuUsage(cpu)).reduce((a, b) => a + b) / 1000;

const reel = await openReel(folder);
for (const { number } of reel.groups) await reel.group(number);
const decoded = spent();
const { fps, frames } = reel.info;
for (let frame = 0; frame < frames; frame++) await reel.frame(frame / fps);
console.log(JSON.stringify({ decode_ms: decoded, all_ms: spent(), memory_bytes: peak() - memory }));
reel.close();
