// A reel among meshes: rings go through the scene, and a click puts a marker on the splats.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { SplatReel } from "@splatreel/three";

const renderer = new THREE.WebGLRenderer({ antialias: true });
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(50, 1, 0.05, 200);
const controls = new OrbitControls(camera, renderer.domElement);
scene.add(new THREE.HemisphereLight(0xffffff, 0x404040, 3));

const reel = new SplatReel("reel/manifest.json", { loop: true, autoplay: true, muted: true });
scene.add(reel);

const rings = new THREE.Group();
scene.add(rings);
const marker = new THREE.Mesh(new THREE.SphereGeometry(1, 24, 16), new THREE.MeshStandardMaterial({ color: 0xff4060 }));
marker.visible = false;
scene.add(marker);

reel.addEventListener("loadedmetadata", () => {
  reel.quaternion.copy(reel.uprightRotation()); // y is up
  reel.viewFromStart(camera);
  const box = new THREE.Box3().setFromObject(reel);
  const [center, size] = [box.getCenter(new THREE.Vector3()), box.getSize(new THREE.Vector3()).length()];
  controls.target.copy(center);
  marker.scale.setScalar(0.01 * size);
  rings.position.copy(center);
  for (const [radius, color] of [[0.16, 0xffc040], [0.24, 0x40c0ff]]) {
    const ring = new THREE.Mesh(new THREE.TorusGeometry(radius * size, 0.008 * size, 16, 96), new THREE.MeshStandardMaterial({ color }));
    ring.rotation.x = Math.PI / 2 + radius;
    rings.add(ring);
  }
});
reel.addEventListener("error", () => (document.getElementById("status").textContent = reel.error.message));

renderer.domElement.addEventListener("click", ({ offsetX, offsetY }) => {
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2((2 * offsetX) / innerWidth - 1, 1 - (2 * offsetY) / innerHeight), camera);
  const [hit] = ray.intersectObject(reel);
  marker.visible = hit !== undefined;
  if (hit) marker.position.copy(hit.point);
  reel.muted = false; // browsers allow sound after a click
});

function resize() {
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(innerWidth, innerHeight);
  camera.aspect = innerWidth / innerHeight;
  camera.updateProjectionMatrix();
}
addEventListener("resize", resize);
resize();

renderer.setAnimationLoop(() => {
  controls.update();
  renderer.render(scene, camera);
  if (reel.canPlay) document.getElementById("status").textContent = `${reel.currentTime.toFixed(1)} of ${reel.duration.toFixed(1)} s, ${reel.points} points. Click to mark a point.`;
});

Object.assign(window, { reel, camera, rings }); // for the console
