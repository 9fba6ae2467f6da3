/** A reel as an object of a three.js scene. */
import { type Access, ReelError } from "@splatreel/decoder/internal";
import { isSameView, ReelPlayer, Sorter, withMediaProperties } from "@splatreel/renderer";
import {
  Box3,
  BufferGeometry,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  Quaternion,
  Ray,
  Sphere,
  Vector3,
  Vector4,
  type Camera,
  type Intersection,
  type Object3DEventMap,
  type PerspectiveCamera,
  type Raycaster,
  type Scene,
  type WebGLRenderer,
} from "three";
import { ThreeRenderer, type Look } from "./three-renderer";
import { viewAlong, viewOf, type CameraView } from "./views";

/** Options of a `SplatReel`. */
export interface SplatReelOptions extends Access {
  autoplay?: boolean;
  loop?: boolean;
  muted?: boolean;
  /** Time at which the reel opens, in seconds. */
  currentTime?: number;
  /** Write the depth of splats, so that transparent objects drawn later are hidden behind them. */
  depthWrite?: boolean;
}

type MediaEventName =
  | "loadstart"
  | "loadedmetadata"
  | "durationchange"
  | "loadeddata"
  | "canplay"
  | "play"
  | "playing"
  | "pause"
  | "timeupdate"
  | "progress"
  | "waiting"
  | "seeking"
  | "seeked"
  | "volumechange"
  | "ended"
  | "error";

/** Events of a `SplatReel`: those of an Object3D, and these of HTMLMediaElement. */
export type SplatReelEventMap = Object3DEventMap & Record<MediaEventName, object>;

/**
 * Plays a reel. It opens when it is drawn for the first time, since its files go to the graphics device of the renderer.
 *
 * The reel keeps the axes and units of its capture. `uprightRotation` and `viewFromStart` relate them to the scene.
 */
export class SplatReel extends withMediaProperties(Mesh<BufferGeometry, MeshBasicMaterial, SplatReelEventMap>) {
  readonly isSplatReel = true;
  private readonly look: Look;
  readonly player: ReelPlayer;
  private three: WebGLRenderer | null = null;
  private renderer: ThreeRenderer | null = null;
  private readonly onLost = (): void => this.close();
  private disposed = false;
  /** True once another renderer tried to draw the reel. */
  private warned = false;
  /** Pixels per unit of slope in the last frame. */
  private focal = 0;

  /** url: address of the reel's manifest.json. */
  constructor(
    url: string,
    {
      autoplay = false,
      loop = false,
      muted = false,
      currentTime,
      depthWrite = false,
      ...access
    }: SplatReelOptions = {},
  ) {
    // three.js draws nothing itself: the object takes part in its order of transparent objects.
    super(new BufferGeometry(), new MeshBasicMaterial({ transparent: true, colorWrite: false, depthWrite: false }));
    this.geometry.setDrawRange(0, 0);
    this.geometry.boundingSphere = new Sphere();
    this.geometry.boundingBox = new Box3();
    this.frustumCulled = false;
    this.look = { depthWrite, opacity: 1, fog: null, scale: 1 };
    this.player = new ReelPlayer(url, (event) => this.emit(event), access);
    this.player.startTime = currentTime ?? null;
    [this.loop, this.muted] = [loop, muted];
    this.onBeforeRender = (renderer, scene, camera, _geometry, material) =>
      void (material === this.material && this.draw(renderer, scene, camera));
    if (autoplay) this.play().catch(() => undefined); // errors are events, too
  }

  /** Factor on all opacities, 0 to 1. */
  get opacity(): number {
    return this.look.opacity;
  }

  set opacity(opacity: number) {
    this.look.opacity = opacity;
  }

  get depthWrite(): boolean {
    return this.look.depthWrite;
  }

  set depthWrite(write: boolean) {
    this.look.depthWrite = write;
  }

  /** Return the rotation that makes the reel's up direction y. Requires the manifest. */
  uprightRotation(): Quaternion {
    const { manifest } = this.player;
    if (!manifest) throw new Error("The manifest of the reel is not here yet. Wait for `loadedmetadata`.");
    return new Quaternion().setFromUnitVectors(new Vector3(...manifest.up).normalize(), new Vector3(0, 1, 0));
  }

  /** Place a camera at the start view of the reel, with its vertical field of view. Requires the manifest. */
  viewFromStart(camera: PerspectiveCamera): void {
    const { manifest } = this.player;
    if (!manifest) throw new Error("The manifest of the reel is not here yet. Wait for `loadedmetadata`.");
    const { viewmat, K, height } = manifest.camera;
    this.updateWorldMatrix(true, false);
    const world = new Matrix4()
      .set(...(viewmat as Parameters<Matrix4["set"]>))
      .invert()
      .scale(new Vector3(1, -1, -1))
      .premultiply(this.matrixWorld);
    world.decompose(camera.position, camera.quaternion, new Vector3());
    camera.fov = (2 * Math.atan(height / 2 / K[4]) * 180) / Math.PI;
    camera.updateProjectionMatrix();
  }

  /** Add the point where a ray meets the splats of the last frame: where half of its light is absorbed. */
  override raycast(raycaster: Raycaster, intersects: Intersection[]): void {
    const {
      renderer,
      player: { manifest, view },
    } = this;
    if (!renderer || renderer.lost || !manifest || !view) return;
    const inverse = new Matrix4().copy(this.matrixWorld).invert();
    const ray = new Ray().copy(raycaster.ray).applyMatrix4(inverse);
    ray.direction.normalize();
    const depth = renderer.depthAlong(viewAlong(ray, this.focal, manifest.near));
    if (depth === null) return;
    const point = ray.at(depth, new Vector3()).applyMatrix4(this.matrixWorld);
    const distance = raycaster.ray.origin.distanceTo(point);
    if (distance >= raycaster.near && distance <= raycaster.far) intersects.push({ distance, point, object: this });
  }

  /** Copy the place and the settings of another reel. Each plays for itself: the time is copied, but not whether it plays. */
  override copy(source: this, recursive?: boolean): this {
    const { geometry, material } = this;
    super.copy(source, recursive);
    [this.geometry, this.material] = [geometry, material];
    this.material.fog = source.material.fog;
    for (const name of [
      "opacity",
      "depthWrite",
      "loop",
      "muted",
      "volume",
      "playbackRate",
      "rendition",
      "positional",
      "currentTime",
    ] as const)
      Object.assign(this, { [name]: source[name] });
    return this;
  }

  /** Return another object of the same reel, which opens and plays for itself. */
  override clone(recursive?: boolean): this {
    return new SplatReel(this.player.url, this.player.access).copy(this, recursive) as this;
  }

  /** Free the memory of the reel, and end its workers and sound. */
  override dispose(): void {
    if (this.disposed) return;
    this.disposed = true;
    super.dispose?.(); // three.js before 0.187 has none
    this.close();
    this.player.dispose();
    this.geometry.dispose();
    this.material.dispose();
  }

  private draw(three: WebGLRenderer, scene: Scene, camera: Camera): void {
    if (this.disposed || this.error || !this.open(three)) return;
    const { player, renderer } = this;
    const { manifest } = player;
    const size = three.getCurrentViewport(new Vector4());
    if (!manifest || size.z < 1 || size.w < 1) return;
    const scale = Math.cbrt(Math.abs(this.matrixWorld.determinant()));
    Object.assign(this.look, { scale, fog: this.material.fog ? scene.fog : null });
    const seenBy = (from: Camera): CameraView => viewOf(from, this.matrixWorld, scale, size.z, size.w, manifest);
    const { view, depth, focal } = seenBy(camera);
    renderer!.depth = depth;
    this.focal = focal;
    // The order serves both eyes of a headset.
    player.draw(view, three.xr.isPresenting ? seenBy(three.xr.getCamera()).view : view, !isSameView(player.view, view));
  }

  /** Open the reel on the first renderer that draws it, whose graphics device gets its files. Returns false if it cannot be drawn. */
  private open(three: WebGLRenderer): boolean {
    if (this.renderer && three === this.three) return true;
    if (this.renderer) {
      if (!this.warned)
        console.warn(
          `${this.player.url} is drawn by one renderer only, the first. Add reel.clone() to the scene of the other one.`,
        );
      this.warned = true;
      return false;
    }
    const why = unsupported(three);
    if (why) this.player.error = new ReelError(why);
    if (why) this.emit("error");
    if (why || three.getContext().isContextLost()) return false;
    this.three = three;
    three.domElement.addEventListener("webglcontextlost", this.onLost);
    this.renderer = ThreeRenderer.create(three, this.look);
    void this.player.open(this.renderer, (failed) => new Sorter(failed));
    return true;
  }

  private close(): void {
    this.player.close();
    this.renderer = null;
    this.three?.domElement.removeEventListener("webglcontextlost", this.onLost);
  }

  private emit(event: string): void {
    if (event === "loadedmetadata") this.setBounds();
    (this.dispatchEvent as (event: { type: string }) => void).call(this, { type: event });
  }

  private setBounds(): void {
    const [low, high] = this.player.manifest!.bounds;
    const box = new Box3(new Vector3(...low), new Vector3(...high));
    this.geometry.boundingBox = box;
    this.geometry.boundingSphere = box.getBoundingSphere(new Sphere());
  }
}

/** Return why a renderer or its settings cannot draw reels; null if it can. */
function unsupported(three: WebGLRenderer): string | null {
  if (!("isWebGLRenderer" in three) && !("resetState" in three))
    return "SplatReel needs three's WebGLRenderer; it does not draw with WebGPURenderer.";
  if (three.capabilities.logarithmicDepthBuffer)
    return "SplatReel does not draw with a logarithmic depth buffer. Use reversedDepthBuffer instead.";
  return null;
}
