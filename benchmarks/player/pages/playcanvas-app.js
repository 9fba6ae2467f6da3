// A PlayCanvas application with a camera: what both of its pages share.
import * as pc from "playcanvas";
import { fov, height, width, worldOf } from "./orbit.js";

export const canvas = document.createElement("canvas");
document.body.append(canvas);
export const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
app.setCanvasFillMode(pc.FILLMODE_NONE, width, height);
app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
const camera = new pc.Entity();
camera.addComponent("camera", { fov, nearClip: 0.05, farClip: 1000, clearColor: new pc.Color(0, 0, 0), toneMapping: pc.TONEMAP_LINEAR });
app.root.addChild(camera);
const matrix = new pc.Mat4();

/** Place the camera; viewmat: world to camera. */
export const pose = (viewmat) => {
  matrix.set(worldOf(viewmat));
  camera.setPosition(matrix.getTranslation());
  camera.setRotation(new pc.Quat().setFromMat4(matrix));
};
