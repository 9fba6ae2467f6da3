/** Which points to show: of the group at a time and of the one that fades out, with the static layers that live at them. */
import type { Scene } from "../draw/scene";
import type { Manifest } from "../reel/manifest";
import { layersAt } from "../reel/reel-file";
import type { Moment } from "../reel/timeline";
import type { Stream } from "../stream/stream";

/** All that shows at a moment. */
export function sceneAt({ current, previous }: Moment, { groups }: Manifest): Scene {
  const layers = [previous, current].flatMap((shown) => (shown ? layersAt(groups[shown.group]) : []));
  return { layers: [...new Set(layers.map(({ uri }) => uri))], current, previous };
}

/** Before the first group is here: the static layers that are, or null. */
export function staticSceneOf({ layersHere: layers }: Stream): Scene | null {
  return layers.length > 0 ? { layers, current: null, previous: null } : null;
}

/** Whether static points are most of a group's picture, so that it is one without those that move. */
export function isMostlyStatic({ groups }: Manifest, { current }: Moment): boolean {
  const group = groups[current.group];
  return layersAt(group).reduce((sum, { points }) => sum + points, 0) >= group.points;
}
