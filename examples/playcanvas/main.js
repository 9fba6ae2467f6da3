// A reel among meshes: rings go through the scene, and the mouse turns the camera.
import * as pc from "playcanvas";
import { CameraControls } from "playcanvas/scripts/esm/camera-controls.mjs";
import { SplatReel } from "@splatreel/playcanvas";

const canvas = document.createElement("canvas");
document.body.append(canvas);
const app = new pc.Application(canvas, { mouse: new pc.Mouse(canvas), touch: new pc.TouchDevice(canvas), keyboard: new pc.Keyboard(window) });
app.setCanvasFillMode(pc.FILLMODE_FILL_WINDOW);
app.setCanvasResolution(pc.RESOLUTION_AUTO);
app.scene.ambientLight = new pc.Color(0.5, 0.5, 0.5);

const camera = new pc.Entity("camera");
camera.addComponent("camera", { nearClip: 0.05, farClip: 200, clearColor: new pc.Color(0, 0, 0) });
camera.addComponent("script");
app.root.addChild(camera);

const light = new pc.Entity("light");
light.addComponent("light", { type: "directional" });
light.setEulerAngles(45, 30, 0);
app.root.addChild(light);

const stage = new pc.Entity("reel");
stage.addComponent("script");
const reel = stage.script.create(SplatReel, { properties: { url: "reel/manifest.json", loop: true, autoplay: true, muted: true } });
app.root.addChild(stage);

const rings = new pc.Entity("rings");
app.root.addChild(rings);

reel.on("loadedmetadata", () => {
  stage.setRotation(reel.uprightRotation()); // y is up
  reel.viewFromStart(camera);
  const { center, halfExtents } = reel.bounds();
  const size = 2 * halfExtents.length();
  rings.setPosition(center);
  for (const [radius, diffuse] of [[0.16, new pc.Color(1, 0.75, 0.25)], [0.24, new pc.Color(0.25, 0.75, 1)]]) {
    const material = new pc.StandardMaterial();
    material.diffuse = diffuse;
    material.update();
    const mesh = pc.Mesh.fromGeometry(app.graphicsDevice, new pc.TorusGeometry({ ringRadius: radius * size, tubeRadius: 0.008 * size, segments: 96, sides: 16 }));
    const ring = new pc.Entity("ring");
    ring.addComponent("render", { meshInstances: [new pc.MeshInstance(mesh, material)] });
    ring.setLocalEulerAngles((radius * 180) / Math.PI, 0, 0);
    rings.addChild(ring);
  }
  const controls = camera.script.create(CameraControls, { properties: { enableFly: false } });
  controls.focus(center);
});

const status = document.getElementById("status");
reel.on("error", (error) => (status.textContent = error.message));
canvas.addEventListener("click", () => (reel.muted = false)); // browsers allow sound after a click
addEventListener("resize", () => app.resizeCanvas());

app.on("update", () => {
  if (reel.canPlay) status.textContent = `${reel.currentTime.toFixed(1)} of ${reel.duration.toFixed(1)} s, ${reel.points} points.`;
});
app.start();

Object.assign(window, { reel, camera, rings }); // for the console
