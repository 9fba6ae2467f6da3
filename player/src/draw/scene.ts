import type { Shown } from "../reel/timeline";

/** What is drawn: layers by their uris, all that live at one of the groups, and which groups. Without a group, every point of the layers. */
export interface Scene {
  layers: string[];
  current: Shown | null;
  previous: Shown | null;
}
