import type { Shown } from "@splatreel/decoder/internal";

/** The groups to draw, and the URIs of all layers that live at one of them. Without a group, all points of the layers are drawn. */
export interface Scene {
  layers: string[];
  current: Shown | null;
  previous: Shown | null;
}

/** Return true if two scenes show the same files at the same frames. */
export function isSameScene(a: Scene | null, b: Scene): boolean {
  const isSame = (one: Shown | null, other: Shown | null): boolean =>
    one?.group === other?.group && one?.frame === other?.frame;
  return (
    a !== null &&
    isSame(a.current, b.current) &&
    isSame(a.previous, b.previous) &&
    a.layers.length === b.layers.length &&
    a.layers.every((uri, i) => uri === b.layers[i])
  );
}
