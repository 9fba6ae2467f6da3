import { height, measure, settle, width } from "./orbit.js";

localStorage.setItem("splatreel-knows-gestures", "1"); // no prompt over the picture
const reel = document.createElement("splat-reel");
reel.style.cssText = `display: block; width: ${width}px; height: ${height}px`;
reel.setAttribute("src", "reel/manifest.json");
document.body.append(reel);
reel.player.resolution.quality = "full";
await reel.player.whenReady();
const sorts = [];
const pose = (viewmat) => {
  reel.camera = { viewmat };
  sorts.push(reel.stats.sortMilliseconds);
};
window.bench = { reel, measure: () => measure(pose, reel.player.canvas), settle: (viewmat) => settle(pose, viewmat), sorts: () => sorts, canvas: reel.player.canvas };
