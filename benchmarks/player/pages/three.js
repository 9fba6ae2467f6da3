import { SplatReel } from "@splatreel/three";
import * as THREE from "three";
import { fov, height, measure, settle, width, worldOf } from "./orbit.js";

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(width, height);
document.body.append(renderer.domElement);
const world = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(fov, width / height, 0.05, 1000);
const reel = new SplatReel("reel/manifest.json");
world.add(reel);
const matrix = new THREE.Matrix4();
const pose = (viewmat) => {
  matrix.fromArray(worldOf(viewmat)).decompose(camera.position, camera.quaternion, camera.scale);
};
renderer.setAnimationLoop(() => renderer.render(world, camera));
await reel.whenReady();
window.bench = { reel, measure: () => measure(pose, renderer.domElement), settle: (viewmat) => settle(pose, viewmat, 30), sorts: () => [], canvas: renderer.domElement };
