import * as GaussianSplats3D from "@mkkellogg/gaussian-splats-3d";
import * as THREE from "three";
import { fov, height, measure, settle, width, worldOf } from "./orbit.js";

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(width, height);
document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera(fov, width / height, 0.05, 1000);
camera.matrixAutoUpdate = true;
// Without cross-origin isolation there is no shared memory, and its documentation advises against the GPU's sort then.
const viewer = new GaussianSplats3D.Viewer({ selfDrivenMode: false, renderer, camera, useBuiltInControls: false, sharedMemoryForWorkers: false, gpuAcceleratedSort: false });
await viewer.addSplatScene("scene.ply", { showLoadingUI: false, progressiveLoad: false, splatAlphaRemovalThreshold: 1 });
const matrix = new THREE.Matrix4();
const pose = (viewmat) => {
  matrix.fromArray(worldOf(viewmat)).decompose(camera.position, camera.quaternion, camera.scale);
  camera.updateMatrixWorld();
};
const draw = () => {
  requestAnimationFrame(draw);
  viewer.update();
  viewer.render();
};
pose((await (await fetch("scene.json")).json()).poses[0]);
draw();
window.bench = { measure: () => measure(pose, renderer.domElement), settle: (viewmat) => settle(pose, viewmat, 30), sorts: () => [viewer.lastSortTime].filter(Boolean), canvas: renderer.domElement };
