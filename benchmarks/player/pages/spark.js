import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import * as THREE from "three";
import { fov, height, measure, settle, width, worldOf } from "./orbit.js";

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(width, height);
document.body.append(renderer.domElement);
const world = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(fov, width / height, 0.05, 1000);
world.add(new SparkRenderer({ renderer }));
const splats = new SplatMesh({ url: "scene.ply" });
await splats.initialized;
world.add(splats);
const matrix = new THREE.Matrix4();
const pose = (viewmat) => {
  matrix.fromArray(worldOf(viewmat)).decompose(camera.position, camera.quaternion, camera.scale);
};
renderer.setAnimationLoop(() => renderer.render(world, camera));
window.bench = { measure: () => measure(pose, renderer.domElement), settle: (viewmat) => settle(pose, viewmat, 30), sorts: () => [], canvas: renderer.domElement };
