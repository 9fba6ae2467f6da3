/** Availability of headsets. The session itself is in a part of the player that is loaded on demand. */
import type { HeadsetLayer } from "@splatreel/renderer";

/** Virtual reality, or a reel in the room of the viewer. */
export type HeadsetMode = "vr" | "ar";

/** A matrix of WebXR, column-major, which TypeScript does not describe. */
interface XrTransform {
  matrix: Float32Array;
  inverse: { matrix: Float32Array };
}

/** A view of a WebXR frame. */
export interface XrView {
  projectionMatrix: Float32Array;
  transform: XrTransform;
}

/** A controller, a hand, or a finger on a screen. */
export interface XrInput {
  targetRayMode: string;
  targetRaySpace: object;
  gripSpace?: object | null;
  gamepad?: { axes: readonly number[] } | null;
}

/** A frame of a WebXR session. */
export interface XrFrame {
  getViewerPose(space: object): { transform: XrTransform; views: XrView[] } | null;
  getPose(space: object, base: object): { transform: XrTransform } | null;
  getHitTestResults(source: object): { getPose(base: object): { transform: XrTransform } | null }[];
}

/** The part of a WebXR session used here. */
export interface XrSession extends EventTarget {
  readonly inputSources?: Iterable<XrInput>;
  updateRenderState(state: { baseLayer: HeadsetLayer }): void;
  requestReferenceSpace(type: string): Promise<object>;
  requestHitTestSource(options: { space: object }): Promise<object>;
  requestAnimationFrame(draw: (now: number, frame: XrFrame) => void): number;
  end(): Promise<void>;
}

/** The browser's WebXR. */
export interface XrSystem {
  isSessionSupported(mode: string): Promise<boolean>;
  requestSession(mode: string, options: object): Promise<XrSession>;
}

/** Return the browser's WebXR; undefined if it has none. */
export function headsetSystem(): XrSystem | undefined {
  return (navigator as { xr?: XrSystem }).xr;
}

/** Resolve to true if a headset, or a phone for its room, is available. */
export async function supportsHeadset(mode: HeadsetMode): Promise<boolean> {
  // Without this check, browsers log an error in frames that may not ask.
  const { featurePolicy } = document as { featurePolicy?: { allowsFeature(name: string): boolean } };
  if (featurePolicy?.allowsFeature("xr-spatial-tracking") === false) return false;
  return (
    (await headsetSystem()
      ?.isSessionSupported(`immersive-${mode}`)
      .catch(() => false)) ?? false
  );
}
