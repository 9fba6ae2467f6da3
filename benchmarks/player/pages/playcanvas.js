import * as pc from "playcanvas";
import { measure, settle } from "./orbit.js";
import { app, canvas, pose } from "./playcanvas-app.js";

const asset = new pc.Asset("scene", "gsplat", { url: "scene.ply" });
app.assets.add(asset);
await new Promise((resolve, reject) => {
  asset.once("load", resolve);
  asset.once("error", reject);
  app.assets.load(asset);
});
const splat = new pc.Entity();
splat.addComponent("gsplat", { asset });
app.root.addChild(splat);
const sorts = [];
app.scene.on("gsplat:sorted", (milliseconds) => sorts.push(milliseconds));
app.start();
window.bench = { measure: () => measure(pose, canvas), settle: (viewmat) => settle(pose, viewmat), sorts: () => sorts, canvas };
