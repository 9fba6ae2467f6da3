/** The points to show: those of the current group and of the one that fades out, and the static layers that live at them. */
import type { Scene } from "../draw/scene";
import { layersAt, type Manifest, type Moment, type Stream } from "@splatreel/decoder/internal";

/** Return the scene at a moment. */
export function sceneAt({ current, previous }: Moment, { groups }: Manifest): Scene {
  const layers = [previous, current].flatMap((shown) => (shown ? layersAt(groups[shown.group]) : []));
  return { layers: [...new Set(layers.map(({ uri }) => uri))], current, previous };
}

/** Return a scene of the static layers alone, to show before the first group arrives; null if there are none. */
export function staticSceneOf({ loadedLayers: layers }: Stream): Scene | null {
  return layers.length > 0 ? { layers, current: null, previous: null } : null;
}

/** Return true if a group has at least as many static as dynamic points, so that a picture without the dynamic ones is worth showing. */
export function isMostlyStatic({ groups }: Manifest, { current }: Moment): boolean {
  const group = groups[current.group];
  return layersAt(group).reduce((sum, { points }) => sum + points, 0) >= group.points;
}
