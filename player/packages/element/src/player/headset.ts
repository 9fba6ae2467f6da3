/**
 * Virtual and augmented reality by WebXR: two views per frame, on the headset's own clock. A pinch or trigger plays and pauses, hands
 * move the reel, thumbsticks the viewer, and in augmented reality the first tap places the reel. This part is loaded on demand.
 */
import { eyeOf, ReelError } from "@splatreel/decoder/internal";
import { HeadsetSpace } from "../camera/headset-space";
import { Limits } from "../camera/limits";
import type { OrbitCamera } from "../camera/orbit-camera";
import { type Eye, type HeadsetLayer, HeadsetMarks, type MarkedEye } from "@splatreel/renderer";
import { HeadsetGrip } from "./headset-grip";
import { positionOf } from "./headset-input";
import { HeadsetPlacement } from "./headset-placement";
import { headsetSystem, type HeadsetMode, type XrFrame, type XrSession } from "./headset-support";
import { HeadsetTeleport } from "./headset-teleport";
import type { Player } from "./player";

/** Intrinsics of a view so wide that its sort order contains all that the eyes see. */
const WIDE = { fx: 0.05, fy: 0.05, cx: 0.5, cy: 0.5 };

/** A running WebXR session of a player. */
export class Headset {
  private readonly camera: OrbitCamera;
  private readonly grip: HeadsetGrip;
  private readonly teleport: HeadsetTeleport;
  private readonly marks: HeadsetMarks;
  /** Pose of the viewer in the last frame. */
  private head: ArrayLike<number> | null = null;

  private constructor(
    private readonly player: Player,
    private readonly session: XrSession,
    private readonly layer: HeadsetLayer,
    private readonly space: object,
    private readonly room: HeadsetSpace,
    private readonly placement: HeadsetPlacement | null,
  ) {
    this.camera = player.camera!;
    this.grip = new HeadsetGrip(session, room, () => this.select());
    this.teleport = new HeadsetTeleport(room, new Limits(player.manifest!));
    this.marks = new HeadsetMarks(player.canvas.getContext("webgl2")!); // WebXR's layers are WebGL's
  }

  /** Show the reel of a player in the headset. Browsers allow this only in response to a click. ended: called when the session ends. */
  static async enter(player: Player, mode: HeadsetMode, ended: () => void): Promise<Headset> {
    const { camera, manifest, stage } = player;
    if (!camera || !manifest || !stage) throw new ReelError("There is no reel to show in the headset yet.");
    const needs = mode === "ar" ? { requiredFeatures: ["hit-test"] } : {};
    const session = await headsetSystem()!.requestSession(`immersive-${mode}`, {
      ...needs,
      optionalFeatures: ["local-floor"],
    });
    let headset: Headset | null = null;
    session.addEventListener("end", () => {
      headset?.marks.delete();
      stage.passthrough = false;
      player.playback.drawInPage();
      ended();
    });
    try {
      const layer = await stage.createHeadsetLayer(session);
      session.updateRenderState({ baseLayer: layer });
      const floor = await session.requestReferenceSpace("local-floor").catch(() => null);
      const space = floor ?? (await session.requestReferenceSpace("local"));
      const room = new HeadsetSpace(manifest, camera.viewmat, floor !== null);
      const placement =
        mode === "ar" ? await HeadsetPlacement.begin(session, room, manifest, eyeOf(camera.viewmat)) : null;
      headset = new Headset(player, session, layer, space, room, placement);
    } catch (error) {
      void session.end();
      throw error;
    }
    stage.passthrough = mode === "ar";
    player.playback.letCallerDraw();
    session.requestAnimationFrame(headset.draw);
    return headset;
  }

  /** End the session. */
  leave(): void {
    void this.session.end();
  }

  /** Place the reel, or else play or pause. */
  private select(): void {
    const { player, placement, head } = this;
    if (placement && !placement.placed) head && placement.place(head);
    else if (player.paused) player.play();
    else player.pause();
  }

  private readonly draw = (now: number, frame: XrFrame): void => {
    const { player, session, space, room, layer, camera, placement } = this;
    if (!player.presented) return;
    session.requestAnimationFrame(this.draw);
    const pose = frame.getViewerPose(space);
    if (!pose || player.camera !== camera) return; // the headset is off, or another reel was opened
    this.head = pose.transform.matrix;
    const marks = placement
      ? placement.update(frame, space)
      : this.teleport.update(frame, space, session.inputSources ?? [], positionOf(this.head));
    const waits = placement?.placed === false;
    if (!waits) this.grip.update(frame, space);
    const [eyes, marked]: [Eye[], MarkedEye[]] = [[], []];
    for (const seen of pose.views) {
      const port = layer.getViewport(seen);
      if (!port) continue;
      const {
        projectionMatrix,
        transform: {
          inverse: { matrix: inverse },
        },
      } = seen;
      const { x, y, width, height } = port;
      eyes.push({
        framebuffer: layer.framebuffer,
        x,
        y,
        view: room.view(inverse, projectionMatrix, width, height, camera.near),
      });
      marked.push({ port, projection: projectionMatrix, inverse });
    }
    if (eyes.length === 0) return;
    const view = {
      ...room.view(pose.transform.inverse.matrix, pose.views[0].projectionMatrix, 1, 1, camera.near),
      ...WIDE,
    };
    if (!waits) player.playback.drawForCaller(now, view, eyes);
    this.marks.draw(layer.framebuffer, marked, marks, waits);
  };
}
