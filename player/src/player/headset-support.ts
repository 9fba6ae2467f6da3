/** Availability of headsets. The session itself is in a part of the player that is loaded on demand. */
import type { HeadsetLayer } from "../draw/renderer";

/** A view of a WebXR frame, which TypeScript does not describe. */
export interface XrView {
  projectionMatrix: Float32Array;
  transform: { inverse: { matrix: Float32Array } };
}

/** A frame of a WebXR session. */
export interface XrFrame {
  getViewerPose(space: object): { transform: { inverse: { matrix: Float32Array } }; views: XrView[] } | null;
}

/** The part of a WebXR session used here. */
export interface XrSession extends EventTarget {
  updateRenderState(state: { baseLayer: HeadsetLayer }): void;
  requestReferenceSpace(type: string): Promise<object>;
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

/** Resolve to true if a headset is available. */
export async function hasHeadset(): Promise<boolean> {
  // Without this check, browsers log an error in frames that may not ask.
  const { featurePolicy } = document as { featurePolicy?: { allowsFeature(name: string): boolean } };
  if (featurePolicy?.allowsFeature("xr-spatial-tracking") === false) return false;
  return (await headsetSystem()?.isSessionSupported("immersive-vr").catch(() => false)) ?? false;
}
