// Decodes a reel frame by frame, and prints the time and memory that it takes: node decode.mjs REEL.
import { openReel } from "@splatreel/decoder";

const reel = await openReel(process.argv[2] ?? "reel");
const { fps, frames, start } = reel.info;
const first = Math.round(start * fps);
console.log(`${frames - first} frames at ${fps} per second, renditions: ${reel.info.renditions.join(", ") || "one"}`);

const began = performance.now();
const shown = new Set();
let [points, arrays] = [0, 0];
for (let number = first; number < frames; number++) {
  const frame = await reel.frame(number / fps);
  const now = performance.now();
  for (const group of frame.groups) shown.add(group);
  points += frame.count;
  arrays = Math.max(arrays, [frame.means, frame.quats, frame.scales, frame.opacities, frame.sh].reduce((sum, { byteLength }) => sum + byteLength, 0));
  if (number === first) console.log(`first frame after ${Math.round(now - began)} ms`);
}
const milliseconds = performance.now() - began;
const megabytes = (bytes) => (bytes / 1e6).toFixed(1);
console.log(`${shown.size} groups, ${(milliseconds / shown.size).toFixed(0)} ms per group, ${(milliseconds / (frames - first)).toFixed(1)} ms per frame`);
console.log(`${Math.round(points / (frames - first))} points and at most ${megabytes(arrays)} MB of arrays per frame, process ${megabytes(process.memoryUsage().rss)} MB`);
console.log(`${megabytes(reel.groups.reduce((sum, { bytes }) => sum + bytes, 0))} MB of groups`);
reel.close();
