/** Interface between the player and the graphics API that draws a reel. `player/graphics.ts` chooses the implementation. */
import type { DecodedGroup, DecodedLayer, Vec3 } from "@splatreel/decoder/internal";
import type { View } from "../base/view";
import type { Cutaway } from "./cutaway";
import type { Eye } from "./eye";
import type { Scene } from "./scene";

/** Draws the Gaussians of one reel. It knows neither time nor downloads. */
export interface Renderer {
  /** True if the browser draws in software, without a graphics device. */
  readonly software: boolean;
  /** True after the graphics device was lost. */
  readonly lost: boolean;
  /** True to leave the canvas transparent where nothing is drawn, instead of filling it with the background. */
  transparent: boolean;
  /** True to leave the eyes of a headset transparent likewise, so that the room shows. */
  passthrough: boolean;
  /** Points that are not drawn; null draws all. */
  cutaway: Cutaway | null;
  /** Number of points in the draw order. */
  readonly points: number;
  /** Wait for the shaders. Throws `ReelError` if the device cannot draw. background: red, green and blue, 0 to 1. */
  begin(antialias: boolean, background: Vec3): void;
  /** Upload a layer. Returns the index of its first point in the draw order. */
  addLayer(uri: string, file: DecodedLayer): number;
  /** Upload a group. layers: URIs of the layers whose points `file.alive` marks. Returns the index of its first point in the draw order. */
  addGroup(index: number, file: DecodedGroup, layers: string[]): number;
  dropLayer(uri: string): void;
  dropGroup(index: number): void;
  /** Return true if all layers and groups of a scene are uploaded. */
  holds(scene: Scene): boolean;
  /** Set the far-to-near order: whole rows of `TEXTURE_WIDTH` indices, of which the first `count` are points. */
  setOrder(order: Uint32Array, count: number): void;
  /** Draw a scene on the canvas, which takes the size of the view. weight: of the current group in a cross-fade, 0 to 1. */
  draw(scene: Scene, weight: number, view: View): void;
  /** Draw a scene once per eye of a headset. */
  drawEyes(scene: Scene, weight: number, eyes: Eye[]): void;
  /** Read the last frame back as RGBA bytes, top row first. */
  readPixels(): Uint8Array;
  /** Return the depth at a pixel of the last frame at which a share of the light is absorbed, half by default, in world units; null if less is. */
  depthAt(x: number, y: number, share?: number): number | null;
  /** Create the layer that a WebXR session shows. */
  createHeadsetLayer(session: object): Promise<HeadsetLayer>;
  /** Free the GPU memory. The device stays with the canvas. */
  destroy(): void;
}

/** A WebXR layer: the framebuffer of both eyes, and the part of it that each view fills. */
export interface HeadsetLayer {
  readonly framebuffer: WebGLFramebuffer | null;
  getViewport(view: object): { x: number; y: number; width: number; height: number } | null;
}

/** The graphics device of a canvas. Browsers limit their number per page, so the player releases the devices of hidden reels. */
export interface GraphicsDevice {
  readonly released: boolean;
  /** Give the device back. */
  release(): void;
  /** Get the device again after `release`. */
  acquire(): Promise<void>;
  /** Create the renderer of a reel. Throws `ReelError` if the browser lacks the graphics API. */
  createRenderer(): Renderer;
}
