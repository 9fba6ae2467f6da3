/** Which points to show: of the group at a time and of the one that fades out, with all static layers born up to it. */
import type { Scene } from "../draw/scene";
import type { Manifest } from "../reel/manifest";
import type { Moment } from "../reel/timeline";
import type { Stream } from "../stream/stream";

/** All that shows at a moment. */
export function sceneAt({ current, previous }: Moment, stream: Stream): Scene {
  return { layers: stream.layersOf(current.group), current, previous };
}

/** Before the first group is here: the static layers that are, or null. */
export function staticSceneOf(stream: Stream): Scene | null {
  const layers = stream.layersReady;
  return layers > 0 ? { layers, current: null, previous: null } : null;
}

/** Whether static points are most of a group's picture, so that it is one without those that move. */
export function isMostlyStatic({ layers, groups }: Manifest, group: number): boolean {
  const points = layers.reduce((sum, layer) => sum + (layer.group <= group ? layer.points : 0), 0);
  return points >= groups[group].points;
}
