import * as pc from "playcanvas";
import { fov, height, measure, settle, width, worldOf } from "./orbit.js";

const canvas = document.createElement("canvas");
document.body.append(canvas);
const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
app.setCanvasFillMode(pc.FILLMODE_NONE, width, height);
app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
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
const camera = new pc.Entity();
camera.addComponent("camera", { fov, nearClip: 0.05, farClip: 1000, clearColor: new pc.Color(0, 0, 0), toneMapping: pc.TONEMAP_LINEAR });
app.root.addChild(camera);
const sorts = [];
app.scene.on("gsplat:sorted", (milliseconds) => sorts.push(milliseconds));
app.start();
const matrix = new pc.Mat4();
const pose = (viewmat) => {
  matrix.set(worldOf(viewmat));
  camera.setPosition(matrix.getTranslation());
  camera.setRotation(new pc.Quat().setFromMat4(matrix));
};
window.bench = { measure: () => measure(pose), settle: (viewmat) => settle(pose, viewmat), sorts: () => sorts, canvas };
