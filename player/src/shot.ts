/** One settled picture of a player, for comparisons and thumbnails. */
import type { Player } from "./player";
import type { Pose } from "./pose";
import type { View } from "./renderer";
import type { Picture } from "./stage";
import { until } from "./until";

/**
 * Pause, go to a time, and draw it for one pose once everything for it is here and sorted.
 * The picture is exactly what the pose asks for, whatever the canvas' size on the page.
 */
export async function takeShot(player: Player, seconds: number, { K, viewmat }: Pose, width: number, height: number): Promise<Picture> {
  await player.whenReady();
  player.pause();
  player.currentTime = seconds;
  await until(player, "seeked", () => !player.seeking);
  const { stage, manifest } = player;
  if (!stage || !manifest) throw new Error("The reel was closed.");
  player.held = true;
  try {
    const view: View = { viewmat, fx: K[0], fy: K[4], cx: K[2], cy: K[5], width, height, near: manifest.near };
    return await stage.snapshot(player.playback.scene, player.clock.moment.weight, view);
  } finally {
    player.held = false;
    player.invalidate();
  }
}
