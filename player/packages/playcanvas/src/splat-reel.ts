/** A reel as a script of a PlayCanvas entity. */
import { type Access, ReelError } from "@splatreel/decoder/internal";
import { BoundingBox, Entity, Mat4, Quat, Script, Vec3, type CameraComponent } from "playcanvas";
import { isSameView, ReelPlayer, type View, viewOfModel, withMediaProperties } from "@splatreel/renderer";
import { Engine } from "./engine";
import { EngineSorter } from "./engine-sorter";
import { PlaycanvasRenderer } from "./playcanvas-renderer";

const modelView = new Mat4();

/** A reel that is open on a device. */
interface Opened {
  renderer: PlaycanvasRenderer;
  sorter: EngineSorter;
}

/** Values with which a `SplatReel` starts. */
export type SplatReelProperties = Access &
  Pick<SplatReel, "url"> &
  Partial<
    Pick<
      SplatReel,
      | "autoplay"
      | "camera"
      | "opacity"
      | "loop"
      | "muted"
      | "currentTime"
      | "volume"
      | "playbackRate"
      | "rendition"
      | "positional"
    >
  >;

/**
 * Plays a reel below its entity: `SplatReel.addTo(entity, { url: "reel/manifest.json", autoplay: true })`.
 *
 * The reel keeps the axes and units of its capture. `uprightRotation` and `viewFromStart` relate them to the scene.
 *
 * Events as in HTMLMediaElement: loadstart, loadedmetadata, durationchange, loadeddata, canplay, play, playing, pause, timeupdate,
 * progress, waiting, seeking, seeked, volumechange, ended, error.
 */
export class SplatReel extends withMediaProperties(Script) {
  static override scriptName = "splatReel";

  /**
   * Camera that decides about view-dependent colors, sharpness and sound; by default the first of the scene.
   * @attribute
   */
  camera: Entity | null = null;

  /**
   * Start to play as soon as the reel opens.
   * @attribute
   */
  autoplay = false;

  /**
   * Factor on all opacities.
   * @attribute
   */
  opacity = 1;

  /** Add a reel to an entity, with a script component if it has none. */
  static addTo(entity: Entity, properties: SplatReelProperties): SplatReel {
    if (!entity.script) entity.addComponent("script");
    return entity.script!.create(SplatReel, { properties }) as SplatReel;
  }

  readonly player: ReelPlayer;
  private splats: Entity | null = null;
  private opened: Opened | null = null;
  private view: View | null = null;

  constructor(args: ConstructorParameters<typeof Script>[0]) {
    super(args);
    this.player = new ReelPlayer("", (event) => void this.fire(event, event === "error" ? this.error : undefined));
    const { graphicsDevice } = this.app;
    const close = (): void => this.close();
    const stop = (): void => {
      graphicsDevice.off("devicelost", close);
      this.close();
      this.player.dispose();
    };
    graphicsDevice.on("devicelost", close);
    this.on("destroy", stop);
    this.on("state", (on: boolean) => this.splats && (this.splats.enabled = on));
  }

  /**
   * Address of the reel's manifest.json. Set it before the first frame.
   * @attribute
   */
  get url(): string {
    return this.player.url;
  }

  set url(url: string) {
    this.player.url = url;
  }

  /** Whether requests of a private reel carry cookies, as in `fetch`. Set it before the first frame. */
  get credentials(): Access["credentials"] {
    return this.player.access.credentials;
  }

  set credentials(credentials: Access["credentials"]) {
    this.player.access.credentials = credentials;
  }

  /** Called with the address of each file before it is requested; returns headers or another address. Set it before the first frame. */
  get request(): Access["request"] {
    return this.player.access.request;
  }

  set request(request: Access["request"]) {
    this.player.access.request = request;
  }

  initialize(): void {
    if (this.autoplay) this.play().catch(() => undefined); // errors are events, too
  }

  update(): void {
    const camera = (this.camera ?? this.app.root.findComponent("camera")?.entity)?.camera ?? null;
    if (this.error || !camera || !this.open()) return;
    const { player, opened } = this;
    opened!.sorter.camera = camera;
    opened!.renderer.opacity = this.opacity;
    if (!player.manifest) return;
    const view = this.viewOf(camera, player.manifest.near);
    player.draw(view, view, !isSameView(this.view, view));
    this.view = view;
  }

  /** Return the rotation that makes the reel's up direction y. Requires the manifest. */
  uprightRotation(): Quat {
    return new Quat().setFromDirections(new Vec3(this.known.up).normalize(), Vec3.UP);
  }

  /** Place a camera at the start view of the reel, with its vertical field of view. Requires the manifest. */
  viewFromStart(camera: Entity): void {
    const { viewmat, K, height } = this.known.camera;
    const pose = new Mat4();
    pose
      .set([...viewmat])
      .transpose()
      .invert();
    const world = new Mat4().mul2(this.entity.getWorldTransform(), pose).mul(new Mat4().setScale(1, -1, -1));
    camera.setPosition(world.getTranslation());
    camera.setRotation(new Quat().setFromMat4(world));
    if (camera.camera) camera.camera.fov = (2 * Math.atan(height / 2 / K[4]) * 180) / Math.PI;
  }

  /** Return the box around most of the points, in the scene. Requires the manifest. */
  bounds(): BoundingBox {
    const [low, high] = this.known.bounds;
    const box = new BoundingBox();
    box.setMinMax(new Vec3(low), new Vec3(high));
    const placed = new BoundingBox();
    placed.setFromTransformedAabb(box, this.entity.getWorldTransform());
    return placed;
  }

  private get known(): NonNullable<ReelPlayer["manifest"]> {
    if (!this.player.manifest) throw new Error("The manifest of the reel is not here yet. Wait for `loadedmetadata`.");
    return this.player.manifest;
  }

  private viewOf(camera: CameraComponent, near: number): View {
    const { renderTarget, rect, projectionMatrix, viewMatrix, nearClip } = camera;
    const { width, height } = renderTarget ?? this.app.graphicsDevice;
    const world = this.entity.getWorldTransform();
    modelView.mul2(viewMatrix, world);
    return viewOfModel(
      modelView.data,
      world.getScale().x,
      projectionMatrix.data,
      width * rect.z,
      height * rect.w,
      near,
      nearClip,
    );
  }

  /** Open the reel on the device of the application. Returns false if it cannot be drawn. */
  private open(): boolean {
    if (this.opened) return true;
    if (!this.url) return false;
    const { app, player } = this;
    if (app.graphicsDevice.isWebGPU) {
      player.error = new ReelError(
        'SplatReel draws with WebGL 2 and not with WebGPU. Create the device with deviceTypes: ["webgl2"].',
      );
      player.emit("error");
      return false;
    }
    this.splats = new Entity("splats");
    this.entity.addChild(this.splats);
    const engine = new Engine(app, this.splats);
    const renderer = new PlaycanvasRenderer(engine);
    const sorter = new EngineSorter(engine, renderer);
    this.opened = { renderer, sorter };
    void player.open(renderer, () => sorter);
    return true;
  }

  private close(): void {
    this.player.close();
    this.splats?.destroy();
    [this.splats, this.opened, this.view] = [null, null, null];
  }
}
