import type { Shown } from "@splatreel/decoder/reel/timeline";

/** The groups to draw, and the URIs of all layers that live at one of them. Without a group, all points of the layers are drawn. */
export interface Scene {
  layers: string[];
  current: Shown | null;
  previous: Shown | null;
}
