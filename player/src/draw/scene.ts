import type { Shown } from "../reel/timeline";

/** What is drawn: how many layers, and which groups. Without a group, every point of the layers. */
export interface Scene {
  layers: number;
  current: Shown | null;
  previous: Shown | null;
}
