/** What the reel needs of a PlayCanvas application. */
import {
  GSplatFormat,
  type AppBase,
  type CameraComponent,
  type Entity,
  type GSplatContainer,
  type GraphicsDevice,
} from "playcanvas";
import { readGlsl } from "./shaders";

/** Frames after which an order counts as drawn, if PlayCanvas does not report it: other splats of the scene may change all the time. */
const MOST_FRAMES = 30;

/** An application, and the entity below which the splats are. */
export class Engine {
  readonly device: GraphicsDevice;
  readonly format: GSplatFormat;

  constructor(
    private readonly app: AppBase,
    readonly parent: Entity,
  ) {
    this.device = app.graphicsDevice;
    this.format = new GSplatFormat(this.device, [], { readGLSL: readGlsl });
  }

  /** Resolve when a camera draws all splats of the scene in their present order. */
  displayed(camera: CameraComponent | null): Promise<void> {
    const {
      systems: { gsplat },
    } = this.app;
    return new Promise((resolve) => {
      let frames = 0;
      const done = (): void => {
        gsplat?.off("frame:ready", look);
        this.app.off("frameend", count);
        resolve();
      };
      const look = (drawn: CameraComponent, _layer: unknown, ready: boolean): void =>
        void (drawn === camera && ready && done());
      const count = (): void => void (++frames >= MOST_FRAMES && done());
      gsplat?.on("frame:ready", look);
      this.app.on("frameend", count);
    });
  }

  /** Call `free` once PlayCanvas no longer draws a container. */
  whenUnused(container: GSplatContainer, free: () => void): void {
    const look = (): void => {
      if (container.refCount > 0) return;
      this.app.off("frameend", look);
      free();
    };
    if (container.refCount > 0) this.app.on("frameend", look);
    else free();
  }
}
