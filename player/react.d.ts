/** JSX types of `<splat-reel>` for React 19: `import type {} from "splatreel-player/react"`. */
import type { ClassAttributes, HTMLAttributes } from "react";
import type { SplatReelElement } from "splatreel-player";

type Properties =
  | "src"
  | "poster"
  | "autoplay"
  | "loop"
  | "muted"
  | "controls"
  | "currentTime"
  | "playbackRate"
  | "volume"
  | "rendition"
  | "section"
  | "crossOrigin"
  | "request";
type CameraAttributes =
  | "camera-orbit"
  | "camera-target"
  | "field-of-view"
  | "min-camera-orbit"
  | "max-camera-orbit"
  | "rotation-per-second"
  | "auto-rotate-delay";
type EventName =
  | "emptied"
  | "loadstart"
  | "durationchange"
  | "loadedmetadata"
  | "loadeddata"
  | "canplay"
  | "play"
  | "playing"
  | "pause"
  | "waiting"
  | "timeupdate"
  | "progress"
  | "seeking"
  | "seeked"
  | "ratechange"
  | "volumechange"
  | "pathchange"
  | "ended"
  | "error";

/** Attributes, properties and events. React listens to events of custom elements by their own names, such as `ontimeupdate`. */
export interface SplatReelAttributes
  extends
    ClassAttributes<SplatReelElement>,
    HTMLAttributes<SplatReelElement>,
    Partial<Pick<SplatReelElement, Properties>>,
    Partial<Record<CameraAttributes, string>>,
    Partial<Record<`on${EventName}`, (event: Event) => void>> {
  loading?: "eager" | "lazy";
  preload?: "auto" | "metadata" | "none";
  gestures?: "cooperative" | "greedy";
  captions?: string;
  transparent?: boolean;
  share?: boolean;
  drop?: boolean | "ask";
  "auto-rotate"?: boolean;
}

declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      "splat-reel": SplatReelAttributes;
    }
  }
}
