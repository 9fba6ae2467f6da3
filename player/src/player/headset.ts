/** Virtual reality by WebXR: two views per frame, on the headset's own clock. A pinch or trigger plays and pauses. This part is loaded on demand. */
import { ReelError } from "@splatreel/decoder/base/errors";
import { HeadsetSpace } from "../camera/headset-space";
import type { Eye } from "../draw/eye";
import { headsetSystem, type XrFrame, type XrSession } from "./headset-support";
import type { Player } from "./player";

/** Intrinsics of a view so wide that its sort order contains all that the eyes see. */
const WIDE = { fx: 0.05, fy: 0.05, cx: 0.5, cy: 0.5 };

/** A running WebXR session of a player. */
export class Headset {
  private constructor(private readonly session: XrSession) {}

  /** Show the reel of a player in the headset. Browsers allow this only in response to a click. ended: called when the session ends. */
  static async enter(player: Player, ended: () => void): Promise<Headset> {
    const { camera, manifest, stage } = player;
    if (!camera || !manifest || !stage) throw new ReelError("There is no reel to show in the headset yet.");
    const session = await headsetSystem()!.requestSession("immersive-vr", { optionalFeatures: ["local-floor"] });
    session.addEventListener("end", () => {
      player.playback.leaveHeadset();
      ended();
    });
    const layer = await stage.createHeadsetLayer(session);
    session.updateRenderState({ baseLayer: layer });
    const floor = await session.requestReferenceSpace("local-floor").catch(() => null);
    const space = floor ?? (await session.requestReferenceSpace("local"));
    const room = new HeadsetSpace(manifest, camera.viewmat, floor !== null);
    session.addEventListener("select", () => (player.paused ? player.play() : player.pause()));
    player.playback.enterHeadset();
    const draw = (now: number, frame: XrFrame): void => {
      if (!player.presented) return;
      session.requestAnimationFrame(draw);
      const pose = frame.getViewerPose(space);
      if (!pose || player.camera !== camera) return; // the headset is off, or another reel was opened
      const eyes = pose.views.flatMap((view): Eye[] => {
        const port = layer.getViewport(view);
        if (!port) return [];
        const { x, y, width, height } = port;
        return [{ framebuffer: layer.framebuffer, x, y, view: room.view(view.transform.inverse.matrix, view.projectionMatrix, width, height, camera.near) }];
      });
      if (eyes.length === 0) return;
      const head = { ...room.view(pose.transform.inverse.matrix, pose.views[0].projectionMatrix, 1, 1, camera.near), ...WIDE };
      player.playback.tickInHeadset(now, head, eyes);
    };
    session.requestAnimationFrame(draw);
    return new Headset(session);
  }

  /** End the session. */
  leave(): void {
    void this.session.end();
  }
}
